"""What the name of a column says: quantity, axis, unit, and whose it is; columns that belong together by it."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from kreisel.recording.header import UNITS, plain_unit

_NOT_READINGS = re.compile(
    r"bias|covar|(^|_)cov|std(?![a-z])|sigma|variance|resid|error|(^|_)err|valid|quality|status|flag|temp|baro|press|"
    r"humid|volt|batter|(?<!specific_)(?<!specific)force|gravity|grav(?![a-z])|(^|_)free|user_?acc|torque|moment|current|(^|_)(lat|lon|alt|gps|gnss)"
)
_END = r"(?=_|$|\d|[wxyz](_|$|\d))"
"""What may follow a short word: the end of a part, a number, or an axis."""

_WORDS: tuple[tuple[str, re.Pattern[str]], ...] = tuple(
    (quantity, re.compile(pattern))
    for quantity, pattern in (
        ("magnetometer", r"magnetometer|magnetic_?field|magneto|magnet|(?<!i)magn?(?=_|$|\d|[xyz](_|$|\d))|compass"),
        ("angle", r"euler|(?<![a-z])(rpy|ypr)(?![a-z])|rot(ation)?_?vec(tor)?|axis_?angle"),
        ("rate", r"gyroscope|gyro|gyr(?!ate)|angular_?velocity|angular_?rate|ang_?vel|ang_?rate|rotation_?rate|"
                 r"rot_?rate|turn_?rate|drehrate|omega"),
        ("acceleration", r"accelerometer|linear_?acceleration|acceleration|specific_?force|beschl(eunigung)?|accel|"
                         r"lin_?acc|(?<![a-z])acc|acc(?![a-z])|(?<=[a-z])acc(?=_?[xyz]?$)"),
        ("velocity", r"velocity|(?<![a-z])(vel|speed)"),
        ("quaternion", r"quaternion|quat"),
        ("matrix", r"rot(ation)?_?mat(rix)?|dcm|direction_?cosines"),
        ("position", rf"position|translation|location|(?<![a-z])(pos|trans|loc){_END}"),
        ("orientation", rf"orientation|attitude|(?<![a-z])(ori|rotation|rot|att){_END}"),
    )
)  # fmt: skip
_TIME = re.compile(r"time|stamp|(^|_)(t|ts|utc|date|datum|clock|ticks?|secs?|seconds?|n_?secs?|nanosecs?|zeit|uhrzeit|"
                   r"epoch|elapsed|stime|toa)(_|$)")  # fmt: skip
_COUNTER = re.compile(r"count|(^|_)(cnt|idx|index|frame|seq|sequence|sample|packet|row|nr|no|id|num)(_|$|\d)")
_SHORT = re.compile(r"(?:^|_)([gwafmbpqtvr])_?([wxyz])(\d*)(?=_|$)")
_SHORT_QUANTITY = {
    "g": "rate", "w": "rate", "a": "acceleration", "f": "acceleration", "m": "magnetometer", "b": "magnetometer",
    "p": "position", "t": "position", "q": "quaternion", "v": "velocity", "r": "angle",
}  # fmt: skip
OF_A_REFERENCE = re.compile(
    r"mocap|vicon|opti|track|quali|robot|tcp|flange|kuka|abb|fanuc|^ur\d*$|^ref|^gt$|truth|ground|rigid|body|marker|"
    r"pose|tool|leica|vive|theodolite|laser"
)
"""Parts of names that are those of a reference."""

_LETTERS = {
    "w": "rate", "g": "rate", "a": "acceleration", "f": "acceleration", "p": "position", "q": "quaternion",
    "r": "orientation", "c": "matrix",
}  # fmt: skip
"""Letters that name whole arrays."""

_MATRIX = re.compile(r"(?:^|_)(?:rot|dcm|r|c|m)?_?([0-4])_?([0-4])$")
_ANGLES = {"roll": "x", "pitch": "y", "yaw": "z", "heading": "z", "phi": "x", "theta": "y", "psi": "z"}
_SCALARS = {"r": "w", "s": "w", "i": "x", "j": "y", "k": "z"}

_SUFFIX_UNITS = {
    "rate": {"dps": "deg/s", "degps": "deg/s", "deg_s": "deg/s", "deg_per_s": "deg/s", "degs": "deg/s",
             "rad_s": "rad/s", "radps": "rad/s", "rads": "rad/s", "rad_per_s": "rad/s", "mdps": "mdps"},
    "acceleration": {"mps2": "m/s^2", "ms2": "m/s^2", "m_s2": "m/s^2", "m_s_2": "m/s^2", "g": "g", "mg": "mg"},
    "position": {"mm": "mm", "cm": "cm", "m": "m"},
    "angle": {"deg": "deg", "rad": "rad"},
    "time": {"ns": "ns", "nsec": "ns", "us": "us", "usec": "us", "ms": "ms", "msec": "ms", "s": "s", "sec": "s",
             "secs": "s", "seconds": "s", "nanos": "ns", "micros": "us", "millis": "ms", "nanoseconds": "ns",
             "microseconds": "us", "milliseconds": "ms"},
}  # fmt: skip
_SPELLINGS = {
    "deg/sec": "deg/s", "degrees/s": "deg/s", "degree/s": "deg/s", "degrees/sec": "deg/s", "deg*s^-1": "deg/s",
    "degps": "deg/s", "grad/s": "deg/s", "rad/sec": "rad/s", "radians/s": "rad/s", "m/s²": "m/s^2", "m/s**2": "m/s^2",
    "m/sec^2": "m/s^2", "m s-2": "m/s^2", "m*s^-2": "m/s^2", "mps2": "m/s^2", "meter": "m", "metre": "m",
    "meters": "m", "degree": "deg", "degrees": "deg", "°": "deg", "radians": "rad", "sec": "s", "seconds": "s",
    "msec": "ms", "millis": "ms", "usec": "us", "nsec": "ns",
}  # fmt: skip


@dataclass(frozen=True)
class Name:
    """What the name of a column says; texts are empty where it says nothing.

    Attributes
    ----------
    quantity
        rate, acceleration, magnetometer, position, velocity, quaternion, angle, matrix, orientation, time, counter,
        other, or nothing.
    axis
        x, y, z, w; a number; row and column of a matrix; for angles the axis they turn about, or A, B, C.
    owner
        What is left of the name, by which columns of one device are known.
    unit
        As written after the name, None where it says none.
    """

    quantity: str
    axis: str
    owner: tuple[str, ...]
    unit: str | None = None


@dataclass(frozen=True)
class Group:
    """Columns that belong together by their names, in the order of their axes.

    Attributes
    ----------
    sheet
        Number of the table.
    axes
        Of the columns; numbers where the names say no axes.
    unit
        That the header or the names state, None where they state none; not one of the quantity where it is unknown.
    named
        Whether names say what it is.
    """

    sheet: int
    places: tuple[int, ...]
    quantity: str
    axes: str
    owner: tuple[str, ...]
    unit: str | None = None
    named: bool = True


def known_unit(text: str | None, quantity: str) -> str | None:
    """Return a unit as the readers know it, None where it is none of the quantity."""
    if text is None:
        return None
    unit = plain_unit(text)
    quantity = {"position": "length"}.get(quantity, quantity)
    for one in (unit, unit.lower(), _SPELLINGS.get(unit.lower(), "")):
        if one and one in UNITS.get(quantity, {}):
            return one
    return None


def read_name(name: str) -> Name:
    """Return what the name of a column says."""
    text, index = _index(name)
    plain = _plain(text)
    if _NOT_READINGS.search(plain):
        return Name("other", index, ())
    for quantity, pattern in _WORDS:
        if (match := pattern.search(plain)) is not None:
            rest, unit = _without_unit(f"{plain[: match.start()]}_{plain[match.end() :]}", quantity)
            axis, owner = _axis(rest, index)
            return _settled(quantity, axis, owner, unit)
    return _short(plain, index)


def _settled(quantity: str, axis: str, owner: tuple[str, ...], unit: str | None) -> Name:
    """Return a name whose quantity is decided by its axis where the word leaves it open."""
    if quantity == "orientation":
        quantity = "matrix" if len(axis) == 2 else "angle" if axis in ("A", "B", "C") else "orientation"
    if quantity == "quaternion":
        axis = _SCALARS.get(axis, axis)
    return Name(quantity, axis, owner, unit)


def _short(plain: str, index: str) -> Name:
    """Return what a short name says, as gx, q0, r11, roll or X."""
    if _TIME.search(plain):
        _, unit = _without_unit(plain, "time")
        return Name("time", index, (), unit)
    for word, axis in _ANGLES.items():
        if (match := re.search(rf"(^|_){word}(?=_|$|\d)", plain)) is not None:
            rest, unit = _without_unit(f"{plain[: match.start()]}_{plain[match.end() :]}", "angle")
            return Name("angle", axis, _parts(rest), unit)
    if (match := _SHORT.search(plain)) is not None and (match[1] == "q" or match[2] != "w"):
        quantity = _SHORT_QUANTITY[match[1]]
        rest, unit = _without_unit(f"{plain[: match.start()]}_{match[3]}_{plain[match.end() :]}", quantity)
        return Name(quantity, match[2], _parts(rest), unit)
    if (match := re.search(r"(?:^|_)q_?(\d)(?=_|$)", plain)) is not None:
        return Name("quaternion", match[1], _parts(plain[: match.start()] + "_" + plain[match.end() :]))
    if (match := _MATRIX.search(plain)) is not None and match[0].strip("_") not in ("", match[1] + match[2]):
        return Name("matrix", match[1] + match[2], _parts(plain[: match.start()]))
    if _COUNTER.search(plain):
        return Name("counter", index, ())
    parts = _parts(plain)
    if index and parts and parts[-1] in _LETTERS:
        return Name(_LETTERS[parts[-1]], index, parts[:-1])
    rest, unit = _without_unit(plain, "position")
    parts = _parts(rest)
    for axis in ("x", "y", "z"):
        if axis in parts:
            owner = tuple(part for part in parts if part != axis)
            meant = not owner or any(part.isdigit() or OF_A_REFERENCE.search(part) for part in owner)
            return Name("position" if meant else "", axis, owner, unit)
    rest, unit = _without_unit(plain, "angle")
    parts = _parts(rest)
    if parts and parts[-1] in ("a", "b", "c"):
        return Name("angle", parts[-1].upper(), parts[:-1], unit)
    return Name("", index, _parts(plain))


def _index(name: str) -> tuple[str, str]:
    """Return a name without the index of a matrix, and the index."""
    match = re.fullmatch(r"(.*?)[(\[]\s*(\d+)\s*(?:,\s*(\d+)\s*)?[)\]]", name.strip())
    return (name, "") if match is None or not match[1] else (match[1], match[2] + (match[3] or ""))


def _plain(text: str) -> str:
    """Return a name in small letters, its parts divided by underlines."""
    divided = re.sub(r"(?<=[a-z])(?=[A-Z])|(?<=\d)(?=[A-Z][a-z])", "_", text.strip())
    for sign, letters in (("°", "deg"), ("²", "2"), ("µ", "u")):
        divided = divided.replace(sign, letters)
    return re.sub(r"[^0-9a-zäöü]+", "_", divided.lower()).strip("_")


def _without_unit(plain: str, quantity: str) -> tuple[str, str | None]:
    """Return a name without the unit after it, and the unit."""
    text = plain.rstrip("_")
    for spelled, unit in sorted(_SUFFIX_UNITS.get(quantity, {}).items(), key=lambda one: -len(one[0])):
        if re.search(rf"(^|_){spelled}$", text) and text != spelled:
            return text[: len(text) - len(spelled)].rstrip("_"), unit
        if quantity == "time" and text in (spelled,) and len(spelled) > 1:
            return text, unit
    return plain, None


def _parts(rest: str) -> tuple[str, ...]:
    return tuple(part for part in rest.split("_") if part)


def _axis(rest: str, index: str) -> tuple[str, tuple[str, ...]]:
    """Return the axis in what is left of a name, and the rest of that."""
    parts = list(_parts(rest))
    if index:
        return index, tuple(parts)
    for wanted in (r"[wxyz]", r"roll|pitch|yaw|heading|phi|theta|psi", r"[ijk]|[abc]|r|s", r"[0-3][0-3]", r"\d"):
        for k in reversed(range(len(parts))):
            if re.fullmatch(wanted, parts[k]):
                axis = _ANGLES.get(parts[k], parts[k].upper() if parts[k] in "abc" else parts[k])
                return axis, tuple(parts[:k] + parts[k + 1 :])
    for k in reversed(range(len(parts))):
        if match := re.fullmatch(r"([xyz])(\d+)", parts[k]):  # gyroX1
            return match[1], (*parts[:k], match[2], *parts[k + 1 :])
    return "", tuple(parts)


def groups_of(sheet: int, names: Sequence[str], units: Sequence[str | None], usable: Sequence[bool]) -> list[Group]:
    """Return the groups of a table's columns: triads, quaternions and matrices that names show."""
    found: dict[tuple[str, tuple[str, ...]], dict[str, int]] = {}
    said = [read_name(name) for name in names]
    alike: dict[tuple[str, tuple[str, ...]], list[tuple[str, int]]] = {}
    for k, name in enumerate(said):
        if usable[k] and name.axis and name.quantity not in ("", "time", "counter", "other"):
            alike.setdefault((name.quantity, name.owner), []).append((name.axis, k))
    for (quantity, owner), columns in alike.items():
        found |= {(quantity, own): members for own, members in _split_by_stem(quantity, owner, columns, names).items()}
    turned = {owner for quantity, owner in found if quantity in ("quaternion", "orientation", "angle", "matrix")}
    for k, name in enumerate(said):  # hand_x beside hand_qw
        if usable[k] and name.quantity == "" and name.axis in ("x", "y", "z") and name.owner in turned:
            found.setdefault(("position", name.owner), {}).setdefault(name.axis, k)
    out = []
    for (quantity, owner), members in found.items():
        for meant, axes in _complete(quantity, set(members)):
            places = tuple(members[axis] for axis in axes)
            stated = {units[k] or said[k].unit for k in places}
            unit = next(iter(stated)) if len(stated) == 1 else next(iter(sorted(map(str, stated - {None}))), None)
            out.append(Group(sheet, places, meant, "".join(a if len(a) == 1 else "" for a in axes), owner, unit))
    return out


def _split_by_stem(
    quantity: str, owner: tuple[str, ...], columns: list[tuple[str, int]], names: Sequence[str]
) -> dict[tuple[str, ...], dict[str, int]]:
    """Return columns by owner and axis: where an axis stands there twice, by what else differs, as gyro_x and gx."""
    members = dict(reversed(columns))
    if len(members) == len(columns):
        return {owner: members}
    by_stem: dict[str, dict[str, int]] = {}
    for axis, k in columns:
        before, _, after = names[k].lower().rpartition(axis.lower())
        by_stem.setdefault(f"{before}?{after}", {}).setdefault(axis, k)
    whole = {(*owner, stem): own for stem, own in by_stem.items() if _complete(quantity, set(own))}
    return whole if len(whole) > 1 else {owner: members}


def _complete(quantity: str, axes: set[str]) -> list[tuple[str, tuple[str, ...]]]:
    """Return quantity and axes of the group that some axes make, none where some are missing."""
    triads = ("xyz", "123", "012")
    if quantity in ("quaternion", "orientation"):
        fitting = [four for four in ("wxyz", "0123", "1234") if axes == set(four)]
        if fitting:
            return [("quaternion", tuple(fitting[0]))]
        if quantity == "quaternion":
            return []
    numbers = sorted(int(a) for a in axes) if all(a.isdigit() and len(a) < 3 for a in axes) else []
    if quantity in ("matrix", "orientation", "position") and len(axes) in (9, 12, 16):
        if numbers and numbers[-1] - numbers[0] + 1 == len(numbers):
            return [("pose matrix" if len(axes) > 9 else "matrix", tuple(sorted(axes, key=int)))]
        if all(len(a) == 2 for a in axes):
            return [("pose matrix" if len(axes) > 9 else "matrix", tuple(sorted(axes)))]
    if quantity == "orientation":
        quantity = "angle"
    if quantity == "angle" and axes >= {"A", "B", "C"}:
        return [("angle", ("A", "B", "C"))]
    for triad in triads:
        if axes == set(triad) or (triad == "xyz" and axes > set(triad) and quantity != "quaternion"):
            return [(quantity, tuple(triad))]
    return []
