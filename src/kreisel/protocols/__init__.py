"""Decoding and encoding of the bytes that robots and IMUs send and receive. No sockets and no clock."""
