"""Bytes to records and back: what robots and IMUs say on the wire. No sockets and no clock."""
