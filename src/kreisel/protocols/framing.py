"""Messages that begin with their length, out of a byte stream."""

from __future__ import annotations

import struct

from kreisel.errors import ProtocolError


class Splitter:
    """Messages with a head of two numbers, one of them a length; however the stream is cut.

    Parameters
    ----------
    protocol
        Its name, for errors.
    head
        The head's layout, as for `struct`.
    length
        Which of the two numbers is the length; the other tells messages apart.
    least, most
        Bytes a message may have.
    whole
        Whether the length counts the head.
    """

    def __init__(self, protocol: str, head: str, *, length: int, least: int, most: int, whole: bool) -> None:
        self._protocol, self._head = protocol, struct.Struct(head)
        self._length, self._least, self._most = length, least, most
        self._counted = 0 if whole else self._head.size
        self._buffer = bytearray()

    def receive(self, data: bytes) -> list[tuple[int, bytes]]:
        """Return the other number and the content of the messages that are whole by now.

        Raises
        ------
        ProtocolError
            If a length is impossible: the stream is then out of step, and must be opened anew.
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
