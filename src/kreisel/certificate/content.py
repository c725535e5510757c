"""What a certificate says of a calibration."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import date
from decimal import Decimal

import numpy as np

from kreisel._version import __version__
from kreisel.calibration.limits import COVERAGE, Decision, Limits, QuantityDecision, judged, overall
from kreisel.calibration.result import Calibration
from kreisel.calibration.result_sections import Measured, RecordingFacts
from kreisel.certificate.words import LANGUAGES, number, words
from kreisel.errors import SettingsError, unknown_name
from kreisel.geometry.rotation import Array
from kreisel.model.groups import REGISTRY, ParameterGroup
from kreisel.recording.nanoseconds import date_of_stamp
from kreisel.recording.recording_settings import CertificateTable, DeviceTable

FIELDS = (*DeviceTable.model_fields, *CertificateTable.model_fields)
"""Keys of `[device]` and `[certificate]`, and of --field."""

_LEFT_OUT = frozenset({"mounting_rotation_deg"})
"""Quantities that are not the device's."""

_PROCEDURES = {
    "ekf": "ekf", "iekf": "iekf", "batch": "batch", "inverse": "inverse", "static": "at_poses",
    **dict.fromkeys(("spkf", "ukf", "cdkf", "ckf"), "sigma_points"),
    **{name: name.replace("-", "_") for name in ("multi-position", "six-position", "ferraris", "turntable", "hinge")},
}  # fmt: skip
"""The sentence on the procedure, `procedure_NAME` of the words, by the name of the estimator or static method."""


@dataclass(frozen=True)
class Row:
    """A quantity: title, unit, three values, limit and decision as texts."""

    title: str
    unit: str
    values: tuple[str, ...]
    limit: str = ""
    decision: str = ""
    kind: str = ""


@dataclass(frozen=True)
class Certificate:
    """A certificate, ready to be set.

    Attributes
    ----------
    language, words
        One of `LANGUAGES`, and its words.
    facts
        Pairs of title and text, in their order.
    axes, pairs, effects
        Rows of the results.
    conformity
        The statement of conformity; empty without limits.
    notes
        Sentences below the results.
    digest, result_digest
        Fingerprints of the data and of calibration.yaml.
    serial_number
        As stated; empty where it is not.
    judged, decision
        The quantities that have a limit, and the decision on all of them; None without limits.
    """

    language: str
    words: Mapping[str, str]
    facts: tuple[tuple[str, str], ...]
    axes: tuple[Row, ...]
    pairs: tuple[Row, ...]
    effects: tuple[Row, ...]
    conformity: str
    notes: tuple[str, ...]
    digest: str
    result_digest: str
    serial_number: str
    judged: tuple[QuantityDecision, ...]
    decision: Decision | None

    @property
    def with_limits(self) -> bool:
        """Whether there are limits."""
        return bool(self.judged)


def fields_of(calibration: Calibration, given: Mapping[str, str]) -> dict[str, str]:
    """Return the fields that recording.toml states, and those given in their place.

    Raises
    ------
    SettingsError
        For an unknown field; the known ones are listed.
    """
    for key, value in given.items():
        if key not in FIELDS:
            raise SettingsError(unknown_name("field", key, FIELDS))
        if not 0 < len(value) <= 200:
            raise SettingsError(f"--field {key}: expected 1 to 200 characters, got {len(value)}")
    facts = calibration.recording
    stated = {} if facts is None else {**facts.device, **facts.certificate}
    return {**stated, **given}


def certificate_of(
    calibration: Calibration,
    fields: Mapping[str, str],
    limits: Limits | None,
    language: str,
    today: date,
    result_digest: str = "",
) -> Certificate:
    """Return the certificate of a calibration.

    Parameters
    ----------
    fields
        As `fields_of` returns them.
    result_digest
        SHA-256 of its calibration.yaml, which the certificate shows.

    Raises
    ------
    SettingsError
        If the calibration was rejected, or the language is unknown.
    """
    if language not in LANGUAGES:
        raise SettingsError(unknown_name("language", language, LANGUAGES))
    if not calibration.accepted:
        raise SettingsError("this calibration was rejected, and a rejected one gets no certificate; see its report")
    own = words(language)
    found = [one for one in judged(calibration, limits) if one.quantity.name not in _LEFT_OUT]
    if limits is not None:
        _check_shown(limits, found)
    exact = limits is not None and limits.grade is None
    rows = {
        kind: [_row(one, own, language, exact=exact) for one in found if one.quantity.of == kind and _shown(one)]
        for kind in ("axes", "pairs")
    }
    return Certificate(
        language,
        own,
        tuple(_facts(calibration, fields, own, language, today)),
        tuple(rows["axes"]),
        tuple(rows["pairs"]),
        tuple(_effects(calibration, own, language)),
        _conformity(found, own),
        tuple(_notes(calibration, found, limits, own, language)),
        "" if calibration.recording is None else calibration.recording.digest or "",
        result_digest,
        fields.get("serial_number", ""),
        tuple(one for one in found if one.limited),
        overall(found),
    )


def _shown(one: QuantityDecision) -> bool:
    """Return whether a quantity has a row: without a number, as distances of a static result, only for its limit."""
    return one.limited or bool(np.isfinite(one.values).any())


def _conformity(found: Sequence[QuantityDecision], own: Mapping[str, str]) -> str:
    """Return the statement of conformity, with the quantities that it is due to; empty without limits."""
    decision = overall(found)
    if decision is None:
        return ""
    due = "; ".join(own[one.quantity.name] for one in found if one.decision is decision)
    return own[f"conformity_{decision.name.lower()}"].format(quantities=due)


def _notes(
    calibration: Calibration, found: Sequence[QuantityDecision], limits: Limits | None, own: Mapping[str, str],
    language: str,
) -> list[str]:  # fmt: skip
    """Return the sentences below the results."""
    out = []
    if limits is not None:
        source = own["limits_of_grade" if limits.grade else "limits_of_file"].format(name=limits.grade or limits.file)
        out.append(f"{own['rule']} {source}")
    out += [f"{own['uncertainty']} {own['meaning']}", own["contributions"]]
    if not all(one.observable for one in found if _shown(one)):
        out.append(own["not_observable"])
    nis = (calibration.consistency.nis_path, calibration.consistency.nis_standstill)
    if np.isfinite(nis[0]):
        path, still = (number(f"{x:.2f}", language) for x in nis)
        out.append(own["consistency" if np.isfinite(nis[1]) else "consistency_motion"].format(path=path, still=still))
    return out


def _check_shown(limits: Limits, found: Sequence[QuantityDecision]) -> None:
    """Raise an error for a limit of something that the certificate does not show: it would be judged by nobody."""
    shown = {one.quantity.name for one in found}
    for name in limits.values:
        if name in _LEFT_OUT:
            raise SettingsError(f"limits.{name}: not a property of the device; leave it out")
        if name not in shown:
            raise SettingsError(f"limits.{name}: this calibration does not have it; leave the limit out")


def _facts(
    calibration: Calibration, fields: Mapping[str, str], own: Mapping[str, str], language: str, today: date
) -> list[tuple[str, str]]:
    recording = calibration.recording
    begin = None if recording is None else date_of_stamp(recording.begin_ns)
    nothing = own["not_stated"]
    out = [(own["object"], own["imu"])]
    out += [(own[key], fields.get(key, nothing)) for key in ("maker", "type", "serial_number")]
    out += [(own[key], fields[key]) for key in ("customer", "laboratory") if key in fields]
    out += [(own[key], fields.get(key, nothing)) for key in ("operator", "place")]
    out += [(own["date"], fields.get("date") or begin or nothing), (own["issued"], today.isoformat())]
    temperature = fields.get("temperature")
    if temperature is None and recording is not None and recording.temperature_c is not None:
        temperature = f"{number(f'{recording.temperature_c:.1f}', language)} °C"
    out.append((own["temperature"], temperature or nothing))
    seen = "" if recording is None else _seen(calibration, recording, own, language)
    stated = fields.get("reference")
    out.append((own["reference"], "; ".join(text for text in (stated, seen) if text) or nothing))
    out.append((own["traceability"], fields.get("traceability", own["no_traceability"])))
    out.append((own["procedure"], fields.get("procedure", own[_procedure(calibration)])))
    if "remarks" in fields:
        out.append((own["remarks"], fields["remarks"]))
    if "number" in fields:
        out.insert(0, (own["number"], fields["number"]))
    return [*out, (own["software"], f"kreisel {__version__}")]


def _seen(calibration: Calibration, recording: RecordingFacts, own: Mapping[str, str], language: str) -> str:
    """Return what the reference was, by what the recording holds."""
    poses, method = recording.reference_poses, calibration.estimator.name if calibration.estimator else ""
    kind = recording.reference_kind if recording.reference_kind in ("robot", "mocap") else "other"
    if not poses:
        kind = "turntable" if method == "turntable" else "gravity"
    texts = {"poses": _grouped(poses, 0, language), "seconds": _grouped(recording.duration_s, 0, language)}
    return own[f"seen_{kind}"].format(name=recording.reference, **texts)


def _procedure(calibration: Calibration) -> str:
    """Return the key of the sentence on the procedure."""
    name = "" if calibration.estimator is None else calibration.estimator.name
    if calibration.recording is not None and not calibration.recording.reference_poses and name not in _PROCEDURES:
        name = "multi-position"
    return f"procedure_{_PROCEDURES.get(name, 'other')}"


def _row(one: QuantityDecision, own: Mapping[str, str], language: str, *, exact: bool) -> Row:
    mark = "" if one.observable else "*"
    return Row(
        own[one.quantity.name],
        _unit(one.quantity.unit, language),
        tuple(_pair(x, u, language) + mark for x, u in zip(one.values, one.uncertainties, strict=True)),
        _limits(one.limits, language, exact=exact),
        "" if one.decision is None else own[one.decision.value],
        "" if one.decision is None else one.decision.name.lower(),
    )


def _limits(values: Array, language: str, *, exact: bool) -> str:
    """Return the limits of three numbers: one text where they are equal."""
    texts = [f"±\u00a0{_limit(x, language, exact=exact)}" if math.isfinite(x) else "–" for x in values.tolist()]
    if len(set(texts)) == 1:
        return "" if texts[0] == "–" else texts[0]
    return " / ".join(texts)


def _limit(value: float, language: str, *, exact: bool) -> str:
    """Return a limit with all its digits, or to three, never with an exponent; thin blanks divide thousands."""
    places = 2 - math.floor(math.log10(value))
    text = f"{Decimal(repr(value)).normalize():,f}" if exact else f"{round(value, places):,.{max(places, 0)}f}"
    return number(text.replace(",", "\u202f"), language)


def _pair(value: float, uncertainty: float, language: str) -> str:
    """Return value and expanded uncertainty, both to two digits of the uncertainty (GUM 7.2.6)."""
    if not math.isfinite(value):
        return "–"
    if not (math.isfinite(uncertainty) and uncertainty > 0.0):
        return number(f"{value:.4g}".replace("-", "−"), language)
    digits = 1 - math.floor(math.log10(uncertainty))
    rounded = round(uncertainty, digits)
    places = max(0, digits)
    return f"{_grouped(round(value, digits), places, language)} ± {_grouped(rounded, places, language)}"


def _grouped(value: float, places: int, language: str) -> str:
    """Return a number with thin blanks between thousands and a true minus sign."""
    return number(f"{value:,.{places}f}".replace(",", "\u202f").replace("-", "−"), language)


def _unit(unit: str, language: str) -> str:
    """Return a unit as the language writes it."""
    return unit.replace("deg", "°") if language == "de" else unit


def _effects(calibration: Calibration, own: Mapping[str, str], language: str) -> list[Row]:
    """Return the effects beyond offset and matrix that were estimated, in the units of the report."""
    out = []
    for group in REGISTRY:
        if not group.is_sensor or group.passing or group.name in _LINEAR:
            continue
        found = _effect(calibration, group)
        if found is None or not np.any(found.deviation > 0.0):
            continue
        values, deviations = found.value.ravel(), found.deviation.ravel()
        size = 3 if values.size % 3 == 0 else 1
        for start in range(0, values.size, size):
            texts = tuple(
                _pair(float(values[i] / group.size), COVERAGE * float(deviations[i] / group.size), language)
                for i in range(start, start + size)
            )
            title = own[group.name]
            if group.name.endswith("polynomial") and values.size > size:
                title = own["order"].format(title=title, row=2 + start // size)
            elif values.size > size:
                title = own["row_of_axis"].format(title=title, row="xyz"[start // size])
            out.append(Row(title, _unit(group.unit, language), texts + ("",) * (3 - len(texts))))
    return out


_LINEAR = frozenset({"gyro_cross_coupling", "gyro_offset", "accel_cross_coupling", "accel_offset", "lever_arms"})


def _effect(calibration: Calibration, group: ParameterGroup) -> Measured | None:
    """Return the numbers of an effect; None where the model does not have it."""
    values, deviations = calibration.sensors, calibration.sensor_sd
    if group.name == "gyro_polynomial":
        return Measured(values.k_w[1:], deviations.k_w[1:])
    if group.name == "accel_polynomial":
        return Measured(values.k_a[1:], deviations.k_a[1:])
    return calibration.others.get(group.path)
