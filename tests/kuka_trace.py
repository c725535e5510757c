"""Traces of a KR C4 for tests, made from what is known of the format: docs/reference/kuka-trace.md."""

import struct

import numpy as np

Columns = dict[str, tuple[str, float, np.ndarray]]
"""Name: unit, factor, values in that unit; the file holds values over factor."""


def header(columns: Columns, r64: str, step: float) -> str:
    """Return the text of a trace's header."""
    length = len(next(iter(columns.values()))[2])
    lines = ["DIAEXTENDED", "", "#BEGINGLOBALHEADER", "  1,DOS", "101,---", '102,rob "#KR125"', "104,06.03.2018"]
    lines += ["111,9.9000000000E+34", "112,High -> Low", "#ENDGLOBALHEADER", ""]
    lines += ["#BEGINCHANNELHEADER", "200,Zeit", "201,Zeitkanal", "202,sec", "210,IMPLIZIT  ", f"220,{length}"]
    lines += ["240,0.00000", f"241,{step:.8f}", "#ENDCHANNELHEADER", ""]
    for place, (name, (unit, factor, _)) in enumerate(columns.items(), start=1):
        lines += ["#BEGINCHANNELHEADER", f"200,{name}", "201,KRCIpo", f"202,{unit}", "210,EXPLIZIT", f"211,{r64}"]
        lines += ["213,BLOCK", "214,REAL64", f"220,{length}", f"221,{place}", "240,0", f"241,{factor!r}"]
        lines += ["#ENDCHANNELHEADER", ""]
    return "\r\n".join(lines)


def payload(columns: Columns) -> bytes:
    """Return the bytes of a trace's values, sample by sample."""
    raw = [[value / factor for value in values] for _, factor, values in columns.values()]
    return b"".join(struct.pack("<d", value) for row in zip(*raw, strict=True) for value in row)
