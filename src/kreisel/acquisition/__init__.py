"""Live recording and driving: the only package, with `devices` and `dashboard`, that has tasks and queues."""
