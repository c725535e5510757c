"""Robots and IMUs on the network: addresses, drivers that read them, and simulated twins that speak the same bytes."""
