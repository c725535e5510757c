"""XML that is safe to parse: UTF-8, without declarations that make a short document expand without limit."""

from __future__ import annotations

import re

_ENCODING = re.compile(r"<\?xml[^>]*?encoding\s*=\s*[\"']([A-Za-z0-9._-]+)[\"']")
_PLAIN = {"utf-8", "utf8", "us-ascii", "ascii"}
_DECLARATION = re.compile(r"<!(DOCTYPE|ENTITY|ELEMENT|ATTLIST|NOTATION)", re.IGNORECASE)


def screened(document: str | bytes) -> str:
    """Return the text of an XML document if it declares no document type and no entities.

    Bytes are decoded first: the check would find nothing in bytes of another encoding.

    Parameters
    ----------
    document
        Bytes in UTF-8, or text.

    Raises
    ------
    ValueError
        If it is not UTF-8, states another encoding, or has such a declaration.
    """
    text = document if isinstance(document, str) else _decoded(document)
    if "\0" in text:
        raise ValueError(f"zero at character {text.index(chr(0))}, as in UTF-16; expected UTF-8")
    found = _DECLARATION.search(text)
    if found is not None:
        raise ValueError(f"declaration '<!{found[1]}' at character {found.start()}; expected elements only")
    return text


def _decoded(data: bytes) -> str:
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise ValueError(f"not UTF-8 (byte {error.start})") from error
    stated = _ENCODING.match(text)
    if stated is not None and stated[1].lower() not in _PLAIN:
        raise ValueError(f"stated to be in {stated[1]}; expected UTF-8")
    return text
