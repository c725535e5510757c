"""Splitting a byte stream into messages that begin with their length."""

from __future__ import annotations

import struct

from kreisel.errors import ProtocolError


class Splitter:
    """Splits a stream into messages whose head is two numbers, one of them a length; chunks of any size.

    Parameters
    ----------
    protocol
        The protocol's name, for errors.
    head
        The head's layout, as for `struct`.
    length
        Index of the number that is the length; the other number identifies the message.
    least, most
        Smallest and largest number of bytes of a message.
    whole
        Whether the length includes the head.
    """

    def __init__(self, protocol: str, head: str, *, length: int, least: int, most: int, whole: bool) -> None:
        self._protocol, self._head = protocol, struct.Struct(head)
        self._length, self._least, self._most = length, least, most
        self._counted = 0 if whole else self._head.size
        self._buffer = bytearray()

    def receive(self, data: bytes) -> list[tuple[int, bytes]]:
        """Return the other number and the content of the messages that are now complete.

        Raises
        ------
        ProtocolError
            If a length is impossible: the position in the stream is then lost, and the connection must be opened again.
        """
        self._buffer += data
        messages, at = [], 0
        while len(self._buffer) - at >= self._head.size:
            numbers = self._head.unpack_from(self._buffer, at)
            length = numbers[self._length]
            if not self._least <= length <= self._most:
                raise ProtocolError(
                    self._protocol, f"message of {length} bytes, expected {self._least} to {self._most}"
                )
            end = at + length + self._counted
            if len(self._buffer) < end:
                break
            messages.append((numbers[1 - self._length], bytes(self._buffer[at + self._head.size : end])))
            at = end
        del self._buffer[:at]
        return messages
