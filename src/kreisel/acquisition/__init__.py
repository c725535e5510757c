"""Recording live: the only place with tasks and queues."""
