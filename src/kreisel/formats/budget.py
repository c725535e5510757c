"""Memory that a file may take: a few bytes of it can stand for gigabytes."""

from __future__ import annotations

MAX_CHUNK = 1 << 26
"""Largest size in bytes of one decompressed chunk or message: 64 MiB; recorders write chunks of 1 to 4 MiB."""

MAX_EXPANSION = 100
"""Largest ratio of the messages of a recording to the size of its file; readings shrink by ten at most."""

_OF_A_MESSAGE = 128  # bytes that Python takes for each besides its content


class TooLargeError(ValueError):
    """More than may be taken into memory."""


class Budget:
    """Memory that may still be used for the messages of a file.

    Parameters
    ----------
    size
        Bytes of the file.
    """

    def __init__(self, size: int) -> None:
        self._most = self._left = MAX_CHUNK + MAX_EXPANSION * size

    def take(self, size: int) -> None:
        """Count a message of `size` bytes.

        Raises
        ------
        TooLargeError
            If the messages are larger than real ones can be.
        """
        self._left -= size + _OF_A_MESSAGE
        if self._left < 0:
            raise TooLargeError(
                f"content of more than {self._most} bytes, over {MAX_EXPANSION} times the file: more than real ones"
            )
