"""Robots and IMUs on the network: addresses, drivers that read them, and simulators that speak the same bytes."""
