"""The report of a small simulated recording: what is in the page, and what must not be."""

import base64
import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kreisel.calibration.calibrate import run_calibration
from kreisel.calibration.cross_validation import cross_validate
from kreisel.calibration.evidence import CrossValidation, Injection
from kreisel.calibration.injection import inject
from kreisel.calibration.outcome import Outcome
from kreisel.calibration.result_sections import Verdict
from kreisel.errors import RecordingError
from kreisel.geometry.rotation import Array
from kreisel.inertial.effects import EFFECTS
from kreisel.inertial.sensor_model import SensorParameters, SizeEffect
from kreisel.model.calibration_settings import CalibrationSettings
from kreisel.recording.recording import DataWarning, Recording
from kreisel.report.budget_figure import budget_picture
from kreisel.report.cells import NOTHING, number, pair
from kreisel.report.data import extract
from kreisel.report.plots import LEVELS, PALETTES, packed
from kreisel.report.report_page import write_report
from kreisel.report.snippet import snippet
from kreisel.report.template import library
from kreisel.report.thinning import MAX_POINTS, enveloped, thinned

from ...small_cell import simulate

SECTIONS = {
    "excitation": "1 Excitation",
    "residuals": "2 Residuals",
    "difference": "3 Difference",
    "uncertainty": "4 Uncertainty",
    "cross-validation": "5 Cross-validation",
}
MAX_PAGE = 2_000_000
Parts = tuple[CrossValidation, Injection]


@pytest.fixture(scope="module")
def recording() -> Recording:
    return simulate(np.random.default_rng(5), 40.0, Path("small"), imu_rate=100.0)[1]


@pytest.fixture(scope="module")
def outcome(recording: Recording) -> Outcome:
    return run_calibration(recording, CalibrationSettings(), budget=True)


@pytest.fixture(scope="module")
def parts(outcome: Outcome) -> Parts:
    found = outcome.estimate
    return cross_validate(found), inject(outcome)


@pytest.fixture(scope="module")
def page(outcome: Outcome, parts: Parts, tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("report") / "report.html"
    write_report(replace(outcome, cross=parts[0]), path, injection=parts[1])
    assert path.stat().st_size < MAX_PAGE
    return path.read_text(encoding="utf-8")


def written(outcome: Outcome, folder: Path, **parts: Any) -> str:
    """Return the page without the library's script."""
    write_report(outcome, folder / "report.html", **parts)
    return (folder / "report.html").read_text(encoding="utf-8").replace(library("uPlot.iife.min.js"), "")


def drawings(page: str) -> dict[str, Any]:
    line = next(line for line in page.splitlines() if line.startswith("const DRAWINGS = "))
    return json.loads(line.removeprefix("const DRAWINGS = ").removesuffix(";"))


# ---- the page ----


def test_the_five_sections_stand_in_their_order(page: str) -> None:
    found = re.findall(r'<section id="([^"]+)">\s*<h2>(\d[^<]+)</h2>', page)
    assert dict(found) == SECTIONS
    assert [anchor for anchor, _ in found] == list(SECTIONS)
    assert page.index("<h2>5 Cross-validation</h2>") < page.index("<h2>How to apply</h2>")


def test_the_library_is_in_the_page_once_and_nothing_is_fetched(page: str) -> None:
    assert page.count(library("uPlot.iife.min.js")) == 1
    own = page.replace(library("uPlot.iife.min.js"), "")
    assert re.findall(r"\bsrc\s*=", own) == []
    assert {link for link in re.findall(r'href="([^"]*)"', own) if not link.startswith("#")} == set()
    for word in ("http:", "https:", "//cdn", "fetch(", "XMLHttpRequest", "import(", "@import", "url(", "WebSocket"):
        assert word not in own, word
    assert "default-src 'none'" in own


def test_every_link_of_the_page_has_its_target(page: str) -> None:
    own = page.replace(library("uPlot.iife.min.js"), "")
    assert set(re.findall(r'href="#([^"]+)"', own)) <= set(re.findall(r'id="([^"]+)"', own))


def test_every_estimated_parameter_appears(page: str, outcome: Outcome) -> None:
    assert len(outcome.calibration.names) > 30
    for name in outcome.calibration.names:
        assert f'<th scope="row">{name}</th>' in page


def test_names_from_outside_are_escaped(outcome: Outcome, tmp_path: Path) -> None:
    hostile = "<img src=x onerror=alert(1)>'\"</script><script>alert(2)</script>"
    recording = replace(outcome.calibration.recording, name=hostile, reference=hostile)
    changed = replace(
        outcome,
        calibration=replace(outcome.calibration, recording=recording),
        warnings=(DataWarning(hostile, hostile),),
        verdict=Verdict(False, (hostile,)),
    )
    own = written(changed, tmp_path)
    assert "<img" not in own
    assert "alert(2)</script>" not in own
    assert own.count("<script>") == 3
    assert own.count("&lt;img src=x onerror=alert(1)&gt;") == 7  # title, headline, name, reference, warning twice, …


def test_missing_parts_are_said_with_how_to_get_them(outcome: Outcome, parts: Parts, page: str, tmp_path: Path) -> None:
    sentences = {
        "cross": "Cross-validation was not made",
        "halves": "Split halves were not compared",
        "injection": "No known errors were injected",
    }
    for sentence in sentences.values():
        assert sentence not in page
    bare = written(replace(outcome, halves=None), tmp_path)
    for sentence in sentences.values():
        assert sentence in bare
    for way in ("--no-validate", "--inject", "validate=True"):
        assert way in bare
    half = written(outcome, tmp_path)
    assert sentences["halves"] not in half
    assert sentences["cross"] in half


def test_the_verdict_is_said_in_words(outcome: Outcome, page: str, tmp_path: Path) -> None:
    assert outcome.verdict.accepted
    assert ">Accepted" in page
    rejected = written(replace(outcome, verdict=Verdict(False, ("the mount slips",))), tmp_path)
    assert ">Rejected<" in rejected
    assert "<li>the mount slips</li>" in rejected
    lost = ("timing.offset", "accelerometer.lever_arms[0,2]")
    gaps = replace(outcome.observability, unobservable=lost)
    weak = written(replace(outcome, observability=gaps, verdict=Verdict(True, (), lost)), tmp_path)
    assert "Accepted, not all observable" in weak
    assert "2 parameters are not observable" in weak
    assert "<h2>Not observable</h2>" in weak
    assert "Time offset of the reference; Position of accelerometer x (z)." in weak
    assert "<h2>Not observable</h2>" not in page


def test_what_is_held_or_fixed_carries_no_deviation(recording: Recording, tmp_path: Path) -> None:
    fixed = run_calibration(recording, CalibrationSettings(fixed=("lever_arms",)))
    own = written(fixed, tmp_path)
    row = next(line for line in own.splitlines() if ">Position of accelerometer x in b<" in line)
    assert "no: user-fixed" in row
    assert "±" not in row
    assert row.count("user-fixed at ") == 3
    assert "<code>lever_arms</code> (fixed by the user)" in own


def test_a_reference_of_positions_alone_has_no_attitude_figures(recording: Recording, tmp_path: Path) -> None:
    assert recording.reference is not None
    alone = replace(recording, reference=replace(recording.reference, quaternions=None))
    found = run_calibration(alone, CalibrationSettings())
    own = written(replace(found, cross=cross_validate(found.estimate)), tmp_path)
    shown = drawings(own)
    assert {"innovations-position", "drift-position"} <= set(shown)
    assert not {"innovations-attitude", "drift-attitude", "synchronisation"} & set(shown)


# ---- the figures ----


KINDS = {
    "line": {"x", "y", "dash", "width"},
    "markers": {"x", "y", "size"},
    "area": {"x", "low", "high"},
    "shade": {"from", "to"},
    "trail": {"x", "y", "width"},
    "matrix": {"values", "names"},
}


def test_every_figure_is_made_of_what_the_page_draws(page: str) -> None:
    shown = drawings(page)
    assert set(re.findall(r'data-figure="([^"]+)"', page)) == set(shown)
    assert len(shown) >= 19
    for name, plot in shown.items():
        for panel in plot["panels"]:
            assert panel["y"]["title"] or panel["y"]["hidden"], name
            assert plot["x"]["title"] or plot["x"]["hidden"], name
            for trace in panel["traces"]:
                assert KINDS[trace["kind"]] <= set(trace), name
                colour, _, opacity = trace["colour"].removeprefix("@").partition("/")
                assert all(colour in palette for palette in PALETTES.values()), name
                assert 0.0 < float(opacity or 1) <= 1.0


def test_no_curve_has_more_points_than_a_screen_shows(page: str) -> None:
    for name, plot in drawings(page).items():
        for trace in (trace for panel in plot["panels"] for trace in panel["traces"]):
            sizes = {unpacked(trace[key]).size for key in ("x", "y", "low", "high") if key in trace}
            assert len(sizes) <= 1, name
            assert max(sizes, default=0) <= 2 * MAX_POINTS, name


def unpacked(array: dict[str, Any]) -> Array:
    levels = np.frombuffer(base64.b64decode(array["data"]), dtype="<u2")
    return np.where(levels > LEVELS, np.nan, array["low"] + levels * array["step"])


def test_packing_keeps_what_a_screen_shows_and_the_gaps() -> None:
    values = np.random.default_rng(2).normal(size=1000)
    values[[3, 500]] = np.nan
    found = unpacked(packed(values))
    np.testing.assert_allclose(found, values, atol=0.5001 * np.ptp(values[np.isfinite(values)]) / LEVELS)
    assert np.isnan(found[[3, 500]]).all()
    np.testing.assert_array_equal(unpacked(packed(np.full(3, 7.0))), 7.0)
    assert np.isnan(unpacked(packed(np.full(3, np.nan)))).all()


def test_an_envelope_holds_every_value() -> None:
    x = np.arange(100_000) * 1e-3
    x[60_000:] += 50.0
    y = np.cumsum(np.random.default_rng(1).normal(size=x.size))
    found = enveloped(x, y, 500)
    assert found.x.size <= 502
    assert np.isnan(found.x).sum() == 1
    assert np.nanmin(found.low) == np.float32(y.min())
    assert np.nanmax(found.high) == np.float32(y.max())
    inside = np.flatnonzero(np.isfinite(found.x))[::7]
    for k in inside:
        near = y[np.abs(x - found.x[k]) < 0.098]
        assert found.low[k] <= near.min() + 1e-3
        assert found.high[k] >= near.max() - 1e-3


# ---- the numbers ----


def test_estimates_over_time_end_at_what_is_reported(outcome: Outcome) -> None:
    tracks = extract(outcome).uncertainty.tracks
    derived = outcome.calibration.document["standard_deviation"]["derived"]
    for group, key in (("gyro_cross_coupling", "gyro_scale_error_ppm"), ("accel_offset", "accel_bias_mg")):
        assert [t.reported_sd for t in tracks[group]] == pytest.approx(derived[key], rel=1e-5)
        for track in tracks[group]:
            rounding = 1e-6 * abs(track.reported)  # curves are single precision
            assert track.value[-1] == pytest.approx(track.reported, abs=1e-3 * track.reported_sd + rounding)
            assert track.deviation[-1] == pytest.approx(track.reported_sd, rel=1e-5)


def test_the_causes_of_the_difference_add_up(outcome: Outcome) -> None:
    d = extract(outcome).difference
    assert d.stop - d.start == pytest.approx(8.0, abs=0.1)
    assert "lever arms" not in d.rates.causes
    for change in (d.rates, d.forces):
        parts = [rms for cause, rms in change.causes.items() if cause != "all"]
        # the rms of a sum lies between nothing and the sum of the rms
        assert np.all(change.causes["all"] <= np.sum(parts, axis=0) * (1.0 + 1e-9))


@pytest.mark.parametrize("order", [1, 2])
def test_the_snippet_does_what_the_calibration_does(outcome: Outcome, order: int) -> None:
    sensors = outcome.calibration.sensors
    if order == 2:
        bend = [1e-3, -2e-3, 3e-3]
        sensors = replace(sensors, k_w=np.vstack([sensors.k_w, bend]), k_a=np.vstack([sensors.k_a, bend]))
    calibration = replace(outcome.calibration, sensors=sensors)
    t = np.arange(0.0, 10.0, 0.005)
    phase = 3.0 * t[:, None] + [0.0, 1.0, 2.0]
    rates, accelerations = np.sin(phase), 5.0 * np.cos(phase) + [0.0, 0.0, 9.8]
    names: dict[str, Any] = {"rates": rates, "accelerations": accelerations, "t": t}
    text = snippet(sensors, SizeEffect.COMPLETED)
    assert len(text.splitlines()) <= 16
    exec(text, names)
    omega, f = calibration.correct(rates, accelerations, t)
    np.testing.assert_allclose(names["omega"], omega, atol=2e-8)
    # to the nine digits that the snippet prints
    np.testing.assert_allclose(names["f"], f, atol=2e-8)


def test_the_snippet_corrects_every_effect(outcome: Outcome) -> None:
    size = {
        "gyro_g_sensitivity": (9, 1e-4),
        "gyro_g_squared": (9, 1e-5),
        "accel_smoothing": (1, 1e-5),
        "accel_delay": (1, 1e-3),
        "gyro_axis_smoothing": (3, 1e-6),
        "accel_axis_smoothing": (3, 1e-6),
    }
    others = {g: np.full(*size.get(g, (3, 1e-3))) for g in EFFECTS if not g.endswith(("polynomial", "drift"))}
    sensors = replace(outcome.calibration.sensors, others=others)
    t = np.arange(0.0, 10.0, 0.005)
    phase = 4.0 * t[:, None] + [0.0, 1.0, 2.0]
    rates, accelerations = np.sin(phase), 5.0 * np.cos(phase) + [0.0, 0.0, 9.8]
    names: dict[str, Any] = {"rates": rates, "accelerations": accelerations, "t": t}
    names["T"] = 30.0 + np.sin(t)
    exec(snippet(sensors, SizeEffect.COMPLETED, 29.0), names)
    recording = outcome.calibration.recording
    assert recording is not None
    warm = replace(outcome.calibration, sensors=sensors, recording=replace(recording, temperature_c=29.0))
    omega, f = warm.correct(rates, accelerations, t, names["T"])
    with pytest.raises(RecordingError, match="temperature coefficients"):
        warm.correct(rates, accelerations, t)
    np.testing.assert_allclose(names["omega"], omega, atol=2e-8)
    np.testing.assert_allclose(names["f"], f, atol=2e-8)


def test_the_snippet_does_not_pretend_to_know_other_forms() -> None:
    text = snippet(SensorParameters.ideal(), SizeEffect.FOX2005)
    assert "Calibration.correct" in text
    assert "K_a.T" not in text


def test_thinning_keeps_peaks_and_gaps() -> None:
    t = np.arange(0.0, 400.0, 0.005)
    y: Array = np.random.default_rng(1).normal(size=t.size)
    y[12345], y[54321] = 99.0, -99.0
    late = t + np.where(t > 200.0, 30.0, 0.0)
    curve = thinned(late, y)
    assert curve.x.size <= MAX_POINTS + 1
    assert np.nanmax(curve.y) == 99.0
    assert np.nanmin(curve.y) == -99.0
    assert np.isnan(curve.x).sum() == 1
    assert np.all(np.diff(curve.x[~np.isnan(curve.x)]) > 0.0)
    short = thinned(t[:100], y[:100])
    np.testing.assert_array_equal(short.y, y[:100].astype(np.float32))


def test_numbers_are_rounded_to_what_their_deviation_carries() -> None:
    assert pair(-15.11993, 0.00903) == "−15.1199 ± 0.0090"
    assert pair(6633.6, 16.8) == "6634 ± 17"
    assert pair(-0.0001, 0.5) == "0.00 ± 0.50"
    assert pair(None, 1.0) == "–"
    assert pair(0.0, 0.0) == "0"
    assert number(2.69e-5) == "2.69·10⁻⁵"
    assert number(float("nan")) == "–"


def test_bars_of_the_budget_show_the_whole_variance(outcome: Outcome, page: str, tmp_path: Path) -> None:
    picture = budget_picture(outcome)
    assert picture is not None
    for bar in picture.bars:
        assert sum(one.percent for one in bar.segments) == pytest.approx(100.0, abs=0.5)  # less than 0.05 % is left out
        assert {one.index for one in bar.segments} <= {one.index for one in picture.legend}
    for row in picture.table.rows:
        assert sum(float(cell) for cell in row.cells[1:] if cell != NOTHING) == pytest.approx(100.0, abs=0.5)
    assert page.count('class="parts"') == len(picture.bars)
    without = replace(outcome, calibration=replace(outcome.calibration, budget=None))
    assert budget_picture(without) is None
    assert 'id="budget"' not in written(without, tmp_path)
