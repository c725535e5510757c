"""A mapping proposed from names and data: names and units first, then the motion, which must confirm it.

Where names and motion contradict each other, or several mappings are equally good, all of them are written as comments,
and the user chooses.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from kreisel.errors import RecordingError, UnknownColumnsError
from kreisel.formats import readings_in_tables as tables
from kreisel.formats.column_names import Group, known_unit, read_name
from kreisel.formats.mapped import settings_beside, tables_in
from kreisel.formats.motion_check import NO_FIT, Fit, by_gravity, compare, thinned_imu, thinned_poses
from kreisel.formats.readable_tables import in_words, most_likely, notes_of, readable
from kreisel.formats.readings_in_tables import Attitude, Device, text_of
from kreisel.formats.separate_files import mapping_of_separate_files
from kreisel.formats.sheet import Sheet
from kreisel.formats.time_columns import (
    SLOWEST_IMU,
    SLOWEST_POSES,
    TimeColumn,
    called,
    counter_of,
    rates_of,
    times_of,
)
from kreisel.formats.write import toml_table
from kreisel.progress import Progress
from kreisel.recording.header import UNITS
from kreisel.recording.recording import ImuSamples
from kreisel.recording.recording_settings import ColumnsTable

CONFIRMED = 0.9
"""Share of the rotation that rates explain, from which a mapping is confirmed."""

_CLEARLY, _ALIKE, _STEADY = 0.1, 2e-3, 0.004
"""Differences of shares: of different devices or bodies; of two ways to read one; of how steady gravity stands."""

_UPRIGHT, _MOVED, _ACCELERATED = 0.05, 0.1, 0.5
"""Differences of `Fit.upright` and `Fit.moved` by which one way to read columns is the better one, and the correlation
from which unnamed columns are positions. Chosen between 1, of the right ones without noise, and 0, of others on
average."""

_UNIT = (0.7, 1.4)
"""Size of the matrix between rates and rotation in a unit that fits: a factor of the root of 2 either way. Chosen: the
units of `_RATE_UNITS` differ by factors of 57 and more, scale factors of sensors by some per cent."""

_STANDS = 0.85
"""Length of the mean acceleration in the axes of the reference, over the mean length, below which gravity turns."""

_FOLLOWS = 0.3
"""Correlation with the turn of gravity from which that shows the unit of the rates."""

_FASTEST_TURN = 60.0
"""rad/s; larger numbers are no rates in rad/s."""

_MAX_TRIES = 40
"""Comparisons of motion; one without a search for the time offset counts a fifth. Chosen: more than the likely pairs of
devices and bodies in a table; unlikely ones are left out, so that a proposal takes seconds."""

_RATE_UNITS = ("rad/s", "deg/s", "mdps")


@dataclass(frozen=True)
class _Try:
    """An IMU and, if there are some, orientations, with their times and how well they agree."""

    device: Device
    times: tuple[str, ...]
    attitude: Attitude | None = None
    pose_times: tuple[str, ...] = ()
    fit: Fit = NO_FIT


@dataclass(frozen=True)
class _Option:
    """Entries of the mapping, and what is to be known of them."""

    imu: dict[str, str]
    reference: dict[str, str]
    why: str = ""


def unknown_columns(
    path: Path, progress: Progress | None = None, given: ColumnsTable | None = None
) -> UnknownColumnsError:
    """Return the error for tables of which nobody said what their columns are, with a proposal where there is one.

    given: entries that stand in the proposal in the place of its own.
    """
    found = tables_in(path)
    try:
        text = _with_entries(proposal(path, progress), given)
    except RecordingError as error:
        return UnknownColumnsError(
            f"the columns are not assigned, and the data suggest no mapping ({in_words(error)}); write [columns] "
            "into recording.toml, or give --map",
            "",
            file=path,
        )
    names = ", ".join(file.name for file in found)
    place = (path if path.is_dir() else path.parent) / "recording.toml"
    choose = "choose among its lines, and " if _CHOOSE in text or _NO_TIME in text else ""
    return UnknownColumnsError(
        f"no mapping says which columns of {names} hold what; {choose}write the mapping above into "
        f"{place}, if it is right, or give all of it by --map",
        text,
        file=path,
    )


def _with_entries(text: str, given: ColumnsTable | None) -> str:
    """Return a proposal with given entries; each replaces that of its name, or stands first in its table."""
    if given is None:
        return text
    stated = given.model_dump(exclude_none=True)
    lines: list[str] = []
    own: dict[str, object] = {}
    for line in text.splitlines():
        if line.startswith("["):
            own = stated.pop(line.strip("[]").rpartition(".")[2], {})
            lines += [line, *(_entry(key, value) for key, value in own.items())]
        elif line.partition(" = ")[0] not in own:
            lines.append(line)
    for table, entries in stated.items():
        lines += ["", f"[columns.{table}]", *(_entry(key, value) for key, value in entries.items())]
    return "\n".join(lines)


def _entry(key: str, value: object) -> str:
    return f"{key} = {json.dumps(value, ensure_ascii=False)}"


_CHOOSE = "# several are possible: remove the marks before the lines of one"
_NO_TIME = "# no column of time was found: write the rate of the rows, or the column"


def proposal(path: Path, progress: Progress | None = None) -> str:
    """Return the mapping that names and data suggest, as TOML to paste; what is open stands there as comments.

    Raises
    ------
    RecordingError
        If no readings of an IMU are found.
    """
    say = progress or _unheard
    sheets, unread = readable(path, say)
    say("find columns", 0.0)
    groups = tables.all_groups(sheets)
    devices = tables.devices(sheets, groups)
    if not devices:
        separate = mapping_of_separate_files(sheets)
        if separate is not None:
            return "\n".join([*separate, *_references_beside(sheets, groups, separate)])
        if unread:
            raise most_likely(unread)
        why = "; ".join(["no three columns are accelerations by name or by the length of gravity, with rates beside",
                         *tables.texts(sheets)])  # fmt: skip
        raise RecordingError(why, file=path)
    taken = {(one.sheet, k) for one in devices if one.named for k in one.places}
    bodies = tables.attitudes(sheets, groups, taken)
    tries = _tried(sheets, devices, bodies, say)
    say("choose columns", 0.0)
    best, notes = _chosen(sheets, tries)
    best = [_with_positions(sheets, groups, one, notes) for one in best]
    against = _contradictions(best)
    notes += against + _own_estimates(best)
    unknown = _unknown_units(best)
    notes += [
        f"[{unit}] is no unit of {quantity} that is known; what stands below is a guess" for quantity, unit in unknown
    ]
    notes += notes_of(unread) + [f"{text}: it is not used" for text in tables.texts(sheets)]
    if not any(one.attitude for one in best):
        notes.append("no orientations were found: if there are poses, name their columns")
    options = [option for one in best for option in _options(sheets, one)]
    comment = "# proposed from the data; check it"
    if len(options) == 1:
        comment += options[0].why
    lines = [comment, *(f"# {note}" for note in dict.fromkeys(notes))]
    hidden = {"rate", "acceleration"} if against else set()
    hidden |= {quantity for quantity, _ in unknown}
    if any(one.attitude is not None and one.fit.explained < CONFIRMED for one in best):
        hidden |= {"time"} if any(_guessed(option.imu.get("time", "")) for option in options) else set()
    lines += _tables(options, hidden)
    if any(option.reference for option in options) and settings_beside(path).reference.kind is None:
        lines.append('# are these poses of motion capture? Then state [reference] kind = "mocap"; a robot is assumed')
    return "\n".join(lines).rstrip()


def _references_beside(sheets: list[Sheet], groups: Sequence[Group], mapping: Sequence[str]) -> list[str]:
    """Return lines, as a comment, for orientations in tables that a mapping does not use; no motion was compared."""
    used = {k for k, sheet in enumerate(sheets) if any(f'"{sheet.source.name}"' in line for line in mapping)}
    named = [group for group in groups if group.sheet not in used]
    for found in tables.attitudes(sheets, named, set()):
        body = found[0]
        if body.group.sheet in used:
            continue
        times = times_of(sheets[body.group.sheet], body.group.places, body.group.owner, SLOWEST_POSES)
        entries = _reference(sheets, body, NO_FIT, times[0].text if times else "")
        lines = [
            "is this the reference? Its motion was not compared; remove the marks if it is",
            *toml_table("columns.reference", entries).splitlines(),
        ]
        return ["", *(f"# {line}" for line in lines)]
    return []


def _unheard(step: str, share: float) -> None:
    """Take progress that nobody asked for."""


# ---- trying


def _tried(sheets: list[Sheet], devices: list[Device], bodies: list[list[Attitude]], progress: Progress) -> list[_Try]:
    """Return what was tried: the likely ways to read each, and, where these do not fit, the others."""
    work = _Work(sheets, progress)
    likely = [(device, one) for device in devices for found in bodies for one in found
              if one.likely and not _overlap(device, one)]  # fmt: skip
    tries = work.run(likely)
    if likely and max(one.fit.explained for one in tries) < CONFIRMED:
        rest = [(device, one) for device in devices for found in bodies for one in found
                if not one.likely and not _overlap(device, one)]  # fmt: skip
        rest += [(device, replace(one, form=form, places=one.group.places)) for device, one in likely
                 if one.form.startswith(("euler", "kuka")) for form in tables.OTHER_SEQUENCES]  # fmt: skip
        tries += work.run(rest)
    if not tries:
        tries = [_Try(device, work.imu_times(device)) for device in devices]
    return tries


def _overlap(device: Device, attitude: Attitude) -> bool:
    return device.sheet == attitude.group.sheet and bool(set(device.places) & set(attitude.group.places))


class _Work:
    """Comparisons of devices and orientations, each stream thinned once."""

    def __init__(self, sheets: list[Sheet], progress: Progress) -> None:
        self._sheets, self._progress = sheets, progress
        self._samples: dict[tuple[Device, str], ImuSamples | None] = {}
        self._times: dict[object, list[TimeColumn]] = {}
        self._done = 0.0

    def run(self, pairs: Sequence[tuple[Device, Attitude]]) -> list[_Try]:
        """Return the comparisons of pairs, not too many."""
        out = []
        for device, attitude in pairs:
            if self._done >= _MAX_TRIES:
                break
            found = self._compared(device, attitude)
            one_clock = device.sheet == attitude.group.sheet and bool({*found.times} & {*found.pose_times})
            self._done += 0.2 if one_clock else 1.0
            self._progress("compare motion", min(self._done / _MAX_TRIES, 1.0))
            out.append(found)
        return out

    def imu_times(self, device: Device) -> tuple[str, ...]:
        """Return the times of an IMU, the likeliest first."""
        return tuple(one.text for one in self._of_device(device)) or _rates(self._sheets[device.sheet], device.rate)

    def _of_device(self, device: Device) -> list[TimeColumn]:
        if device not in self._times:
            self._times[device] = times_of(
                self._sheets[device.sheet], device.rate.places, device.rate.owner, SLOWEST_IMU
            )
        return self._times[device]

    def _compared(self, device: Device, attitude: Attitude) -> _Try:
        group = attitude.group
        if group not in self._times:
            self._times[group] = times_of(self._sheets[group.sheet], group.places, group.owner, SLOWEST_POSES)
        own, other = self._of_device(device), self._times[group]
        pairs = [(a, b) for a in own for b in other if 0.2 <= b.seconds / a.seconds <= 5.0
                 and (device.sheet != group.sheet or a.places != b.places or a.text == b.text)]  # fmt: skip
        first = tuple(dict.fromkeys(a.text for a, _ in pairs)) or self.imu_times(device)
        second = tuple(dict.fromkeys(b.text for _, b in pairs)) or tuple(b.text for b in other)
        second = second or _rates(self._sheets[group.sheet], group)
        tried = _Try(device, first, attitude, second)
        fits = [(a, b, self.fit(device, attitude, a, b)) for a in first[:2] for b in second[:2]]
        if not fits:
            return tried
        best = max(fit.explained for _, _, fit in fits)
        good = [(a, b) for a, b, fit in fits if fit.explained > best - _CLEARLY]
        fit = max((fit for _, _, fit in fits), key=lambda one: one.explained)
        return replace(tried, times=tuple(dict.fromkeys(a for a, _ in good)),
                       pose_times=tuple(dict.fromkeys(b for _, b in good)), fit=fit)  # fmt: skip

    def fit(self, device: Device, attitude: Attitude, time: str, pose_time: str) -> Fit:
        """Return how well a device and orientations agree, by times."""
        imu = self.samples(device, time)
        sheet = self._sheets[attitude.group.sheet]
        position = None if attitude.position is None else tables.numbers(sheet, attitude.position.places)
        poses = thinned_poses(sheet, pose_time, tables.values_of(sheet, attitude), position)
        if imu is None or poses is None:
            return NO_FIT
        return compare(imu, poses, one_clock=device.sheet == attitude.group.sheet and time == pose_time)

    def samples(self, device: Device, time: str) -> ImuSamples | None:
        """Return the thinned samples of a device, accelerations in SI, rates as in the table."""
        if (device, time) not in self._samples:
            imu = thinned_imu(self._sheets[device.sheet], time, device.rate.places, device.force.places)
            size = UNITS["acceleration"][device.force_unit]
            self._samples[device, time] = None if imu is None else replace(imu, accelerations=size * imu.accelerations)
        return self._samples[device, time]


def _rates(sheet: Sheet, group: Group) -> tuple[str, ...]:
    """Return rates that single numbers state, with the column that counts rows where there is one."""
    found, counter = rates_of(sheet, group.owner), counter_of(sheet, group.places)
    return tuple(text if counter is None else f"{called(sheet, counter)} [{text}]" for text in found)


# ---- choosing


def _chosen(sheets: list[Sheet], tries: list[_Try]) -> tuple[list[_Try], list[str]]:
    """Return what fits best, several where they fit alike, and notes."""
    most = max(one.fit.explained for one in tries)
    if most < CONFIRMED:
        return _unconfirmed(tries, most)
    # the device's own estimate follows its gyros better than any reference does
    good = [one for one in tries if one.fit.explained > (CONFIRMED if _by_name(one) else most - _CLEARLY)]
    good = [one for group in _by_columns(good) for one in _best_reading(group)]
    notes = []
    likely = [one for one in good if one.attitude is not None and one.attitude.likely]
    if not likely:
        notes.append("the names alone do not fit the motion; read as below they do")
    followers = {one.attitude.group: one for one in good if one.attitude is not None}
    preferred = {group for group, one in followers.items() if one.attitude is not None and one.attitude.of_a_reference}
    if len(preferred) == 1 and len(followers) > 1:
        others = [_listed(sheets, group) for group in followers if group not in preferred]
        notes.append(f"{'; '.join(others)} follow the motion, too: an estimate of the device itself is no reference")
        good = [one for one in good if one.attitude is not None and one.attitude.group in preferred]
    elif len(followers) > 1:
        listed = "; ".join(_listed(sheets, group) for group in followers)
        notes.append(f"{listed} follow the motion alike: an estimate of the device itself is no reference")
    return good, notes


def _by_name(one: _Try) -> bool:
    """Return whether names say what the columns are, and how they are read."""
    return one.device.named and one.attitude is not None and one.attitude.likely and one.attitude.group.named


def _contradictions(best: list[_Try]) -> list[str]:
    """Return what contradicts the names of the readings, though the rates explain the rotation."""
    out = []
    confirmed = [one.fit for one in best if one.fit.explained >= CONFIRMED]
    if any(fit.handed < 0.0 for fit in confirmed):
        out.append("names and motion contradict each other: the rates mirror the rotation; an axis has the wrong sign, "
                   "or two are exchanged")  # fmt: skip
    elif any(fit.steady < _STANDS for fit in confirmed):
        out.append("names and motion contradict each other: gravity does not stand still where the accelerations are "
                   "turned as the rates and orientations say; are their axes in another order")  # fmt: skip
    return out


def _unknown_units(best: list[_Try]) -> list[tuple[str, str]]:
    """Return quantities of the IMU and their units as the header states them, where these are none that are known."""
    stated = [(q, group.unit) for one in best
              for q, group in (("rate", one.device.rate), ("acceleration", one.device.force))]  # fmt: skip
    return list(dict.fromkeys((q, unit) for q, unit in stated if unit and known_unit(unit, q) is None))


def _own_estimates(best: list[_Try]) -> list[str]:
    """Return the note about orientations that may be the device's own."""
    for one in best:
        body = one.attitude
        if body is not None and not body.of_a_reference and body.position is None and (
            body.group.sheet == one.device.sheet and body.form != "pose matrix"
        ):  # fmt: skip
            return ["are these orientations an estimate of the device itself? Then they are no reference"]
    return []


def _unconfirmed(tries: list[_Try], most: float) -> tuple[list[_Try], list[str]]:
    """Return what names say, where the motion confirms nothing."""
    known = [one for one in tries if one.attitude is not None and one.attitude.likely and one.attitude.group.named]
    if not known:
        found = {one.device: replace(one, attitude=None, pose_times=()) for one in reversed(tries)}
        return list(found.values()), []
    if most >= 0.0:
        notes = [f"the motion does not confirm it: rates explain {100 * most:.0f} % of the rotation at most"]
    else:
        notes = ["the motion does not confirm it, the stamps may be in another unit"]
    best = [max(group, key=lambda one: one.fit.explained) for group in _by_columns(known)]
    return (best if len(best) == 1 and _clear(best[0]) else known[:8]), notes


def _clear(one: _Try) -> bool:
    """Return whether names alone say how orientations are read."""
    return one.device.named and one.attitude is not None and (
        one.attitude.group.axes == "wxyz" or one.attitude.form in ("kuka abc",)
    )  # fmt: skip


def _by_columns(tries: list[_Try]) -> list[list[_Try]]:
    """Return tries in groups of the same columns."""
    out: dict[object, list[_Try]] = {}
    for one in tries:
        assert one.attitude is not None  # noqa: S101 - for the type checker: something was explained
        out.setdefault((one.device, one.attitude.group), []).append(one)
    return list(out.values())


def _best_reading(tries: list[_Try]) -> list[_Try]:
    """Return the ways to read the same columns that fit about as well as the best one."""
    most = max(one.fit.explained for one in tries)
    alike = [one for one in tries if one.fit.explained > most - _ALIKE]
    steady = max(one.fit.steady for one in alike)
    alike = [one for one in alike if one.fit.steady > steady - _STEADY]
    for value, least in (("moved", _MOVED), ("upright", _UPRIGHT)):
        best = max(float(getattr(one.fit, value)) for one in alike)
        alike = [one for one in alike if float(getattr(one.fit, value)) > best - least]
    return [alike[0]] if len({_same(one) for one in alike}) == 1 else alike


def _same(one: _Try) -> tuple[object, ...]:
    attitude = one.attitude
    if attitude is None:
        return ()
    form = attitude.form
    if form == "kuka abc":
        form = "euler ZYX"
    if form.startswith("euler") and form[-3:].islower():  # about fixed axes: the other way round about the body's
        return (form.upper()[-1:-4:-1], attitude.places[::-1], attitude.signs[::-1])
    return (form[-3:] if form.startswith("euler") else form, attitude.places, attitude.signs)


def _with_positions(sheets: list[Sheet], groups: Sequence[Group], one: _Try, notes: list[str]) -> _Try:
    """Return a try with positions without names, where their accelerations are those of the IMU; notes get the rest."""
    if one.attitude is None or one.attitude.position is not None:
        return one
    named = tables.named_positions(sheets, groups, one.attitude)
    if named:
        notes.append(f"which are the positions: {', or '.join(_listed(sheets, group) for group in named)}")
        return one
    found, work = [], _Work(sheets, _unheard)
    for window in tables.possible_positions(sheets, groups, one.device, one.attitude):
        if one.fit.explained < CONFIRMED:
            break
        fit = work.fit(one.device, replace(one.attitude, position=window), one.times[0], one.pose_times[0])
        found.append((fit.moved, window.places, replace(one, attitude=replace(one.attitude, position=window), fit=fit)))
    found.sort(key=lambda each: each[:2], reverse=True)
    if found and found[0][0] > _ACCELERATED and all(found[0][0] > other[0] + _MOVED for other in found[1:]):
        return found[0][2]
    if found:
        notes.append("positions have no name, and the motion does not show which columns they are; add them if there "
                     "are some")  # fmt: skip
    return one


# ---- entries


def _options(sheets: list[Sheet], one: _Try) -> list[_Option]:
    """Return the mappings of a try: several if a time or a unit is open."""
    sheet, work = sheets[one.device.sheet], _Work(sheets, _unheard)
    out = []
    for time in one.times or ("",):
        for unit in _rate_units(one, work.samples(one.device, time) if time else None, sheet):
            for force_unit in _force_units(one.device):
                if (unit, force_unit) == ("mdps", "cm/s^2"):  # thousandths go with thousandths
                    continue
                imu = {"file": sheet.source.name}
                imu |= {"time": time} if time else {}
                imu["rate"] = text_of(sheet, one.device.rate.places, "rate", unit)
                imu["acceleration"] = text_of(sheet, one.device.force.places, "acceleration", force_unit)
                references = [
                    _reference(sheets, one.attitude, one.fit, pose_time) for pose_time in one.pose_times or ("",)
                ]
                out += [_Option(imu, reference, _why(one)) for reference in references]
    return out


def _why(one: _Try) -> str:
    if one.fit.explained >= CONFIRMED:
        return f": the rates explain {100 * one.fit.explained:.1f} % of the rotation"
    return ""


def _force_units(device: Device) -> list[str]:
    """Return the unit of accelerations; two where the header states another one than gravity shows."""
    stated = known_unit(device.force.unit, "acceleration")
    if stated is None or UNITS["acceleration"][stated] == UNITS["acceleration"][device.force_unit]:
        return [stated or device.force_unit]
    return [device.force_unit, stated]


def _rate_units(one: _Try, imu: ImuSamples | None, sheet: Sheet) -> list[str]:
    """Return the unit of the rates; several where what is stated and what is seen differ, or nothing shows it."""
    stated = known_unit(one.device.rate.unit, "rate")
    seen = [unit for unit in _RATE_UNITS if one.fit.explained >= CONFIRMED
            and _UNIT[0] < one.fit.size / UNITS["rate"][unit] < _UNIT[1]]  # fmt: skip
    if imu is not None:
        size, correlation = by_gravity(imu)
        fallen = [unit for unit in _RATE_UNITS if 0.25 < size / UNITS["rate"][unit] < 4.0]
        seen += fallen if correlation > _FOLLOWS else []
    if stated is not None:
        others = [unit for unit in seen if UNITS["rate"][unit] != UNITS["rate"][stated]]
        return list(dict.fromkeys([stated, *others]))
    if seen:
        return list(dict.fromkeys(seen))
    largest = float(np.nanmax(np.abs(tables.numbers(sheet, one.device.rate.places))))
    return ["deg/s"] if largest > _FASTEST_TURN else ["rad/s", "deg/s"]


def _reference(sheets: list[Sheet], attitude: Attitude | None, fit: Fit, time: str) -> dict[str, str]:
    """Return the entries of the reference."""
    if attitude is None:
        return {}
    sheet = sheets[attitude.group.sheet]
    out = {"file": sheet.source.name}
    out |= {"time": time} if time else {}
    if attitude.position is not None:
        out["position"] = text_of(sheet, attitude.position.places, "length", _length_unit(sheet, attitude, fit))
    unit = attitude.unit if attitude.form.startswith(("euler", "kuka", "rotation")) else None
    columns = text_of(sheet, attitude.places, "angle", unit, attitude.signs)
    out["orientation"] = f"{attitude.form}: {columns}"
    return out


def _length_unit(sheet: Sheet, attitude: Attitude, fit: Fit) -> str:
    """Return the unit of positions: as stated, as their accelerations show, or by their size."""
    group = attitude.position
    assert group is not None  # noqa: S101 - for the type checker; the caller looked
    stated = known_unit(group.unit, "length")
    if stated is not None:
        return stated
    if fit.moved > 0.5:
        return min(("m", "cm", "mm"), key=lambda unit: abs(np.log(fit.length / UNITS["length"][unit])))
    usual = float(np.nanmedian(np.abs(tables.numbers(sheet, group.places))))
    return "mm" if usual > 20.0 else "m"


def _listed(sheets: list[Sheet], group: Group) -> str:
    sheet = sheets[group.sheet]
    return ", ".join(called(sheet, k) for k in group.places)


def _guessed(time: str) -> bool:
    """Return whether the unit of a time is neither in its name nor in the header, but follows from its rate."""
    name, _, unit = time.partition(" [")
    return bool(unit) and " + " not in time and not unit.endswith("Hz]") and read_name(name).unit is None


def _tables(options: list[_Option], unsure: set[str]) -> list[str]:
    """Return the tables of a mapping; entries in which the options differ are comments, one block for each option.

    So are entries of the IMU that are `unsure`.
    """
    lines: list[str] = []
    for name, all_of_them in (("imu", [o.imu for o in options]), ("reference", [o.reference for o in options])):
        blocks = list(dict.fromkeys(tuple(entries.items()) for entries in all_of_them))
        if blocks == [()]:
            continue
        hidden = {key for key, _ in blocks[0]} & unsure if name == "imu" else set()
        common = {key: value for key, value in blocks[0]
                  if key not in hidden and all((key, value) in block for block in blocks)}  # fmt: skip
        if name == "imu" and not any("time" in dict(block) for block in blocks):
            lines.append(_NO_TIME)
        lines.append(toml_table(f"columns.{name}", common).rstrip("\n"))
        if len(blocks) > 1 or hidden:
            lines.append(_CHOOSE)
            for k, block in enumerate(blocks):
                own = toml_table("x", {key: value for key, value in block if key not in common})
                lines += [*(["#"] if k else []), *(f"# {line}" for line in own.splitlines()[1:] if line)]
        lines.append("")
    return lines
