"""What `kreisel calibrate` prints: the verdict in the report's words, and what was held instead of estimated."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from kreisel.calibration.calibrate import run_calibration
from kreisel.calibration.outcome import Outcome
from kreisel.calibration.result_sections import Verdict
from kreisel.cli.terminal_tables import print_result, print_rows, print_sentences
from kreisel.model.calibration_settings import CalibrationSettings
from kreisel.report.report_page import write_report

from ...small_cell import simulate


@pytest.fixture(autouse=True)
def on_a_pipe(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("COLUMNS", raising=False)


@pytest.fixture(scope="module")
def outcome() -> Outcome:
    recording = simulate(np.random.default_rng(5), 40.0, Path("small"), imu_rate=100.0)[1]
    fixed = {"lever_arms": np.zeros((3, 3)), "gyro_offset": None, "time_offset": None, "time_skew": 3e-6}
    return run_calibration(recording, CalibrationSettings(fixed=fixed))


def printed(outcome: Outcome, capsys: pytest.CaptureFixture[str]) -> str:
    print_result(outcome.calibration, outcome.warnings)
    return " ".join(capsys.readouterr().out.split())


@pytest.mark.parametrize("lost", [(), ("timing.offset",), ("timing.offset", "accelerometer.lever_arms[0,2]")])
@pytest.mark.parametrize("reasons", [(), ("innovations are too large", "scale factors are far from 1")])
def test_terminal_report_and_json_say_the_same(
    outcome: Outcome,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    lost: tuple[str, ...],
    reasons: tuple[str, ...],
) -> None:
    verdict = Verdict(not reasons, reasons, lost)
    changed = replace(
        outcome,
        verdict=verdict,
        observability=replace(outcome.observability, unobservable=lost),
        calibration=replace(outcome.calibration, verdict=verdict),
    )
    text = printed(changed, capsys)
    headline = "Rejected" if reasons else "Accepted, not all observable" if lost else "Accepted"
    assert verdict.headline == headline
    assert f"verdict: {headline.lower()[0]}{headline[1:]}. {verdict.sentence}" in text
    assert all(reason in text for reason in reasons)
    assert all(name in text for name in lost)
    write_report(changed, tmp_path / "report.html")
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert f"<h2>{headline}</h2>" in page
    assert f"<p>{verdict.sentence}</p>" in page


def test_the_document_has_the_summary(outcome: Outcome) -> None:
    verdict = outcome.calibration.document["verdict"]
    assert verdict["summary"] == outcome.verdict.summary


def test_what_is_held_is_not_printed_as_estimated(outcome: Outcome, capsys: pytest.CaptureFixture[str]) -> None:
    text = printed(outcome, capsys)
    assert "0.00 ± 0.00" not in text
    assert "± 0.00 " not in text
    lines = text.split("│")
    for title, cells in (
        ("position of accelerometer x in b", 3),
        ("gyro bias", 3),
        ("time offset of the reference", 1),
    ):
        at = next(k for k, cell in enumerate(lines) if title in cell)
        said = "not determined" if title == "gyro bias" else "user-fixed at "  # nobody stated a value
        assert all(said in cell for cell in lines[at + 2 : at + 2 + cells]), title
    assert "user-fixed at 3 " in lines[next(k for k, cell in enumerate(lines) if "ratio of the clocks" in cell) + 2]
    at = next(k for k, cell in enumerate(lines) if "gyro scale-factor error" in cell)
    assert all("±" in cell for cell in lines[at + 2 : at + 5])


# Tables in the width of a terminal

WIDE = ["cell", "estimator", "runs", "largest error", "error / sd", "its 95 % interval", "within 68 %", "within 95 %"]
ROWS = [
    ["consumer-mems, joints, 10 deg, 0.5 %, weak", "spkf", "12", "1.6", "0.71", "0.60 to 1.42", "66.7 %", "100.0 %"],
    ["all", "spkf", "120", "-2.6", "0.92", "0.59 to 0.76", "77.8 %", "100.0 %"],
]


def lines(capsys: pytest.CaptureFixture[str]) -> list[str]:
    return [line.rstrip() for line in capsys.readouterr().out.splitlines()]


@pytest.mark.parametrize("width", [200, 100, 80, 64])
def test_tables_fit_the_terminal_and_nothing_is_cut(
    width: int, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Numbers stay whole and in their order, all words are there, and no line is longer than the terminal."""
    monkeypatch.setenv("COLUMNS", str(width))
    print_rows("a title", WIDE, ROWS)
    shown = lines(capsys)
    assert max(map(len, shown)) <= width
    assert ("│" in "".join(shown)) == (width == 200)
    assert "…" not in "".join(shown)
    words = {word.strip("│┃,") for line in shown for word in line.split()}
    assert {part.strip(",") for text in (*WIDE, ROWS[0][0]) for part in text.split()} <= words
    for row in ROWS:
        line = next(line for line in shown if row[5] in line)
        at = [line.rindex(cell) for cell in row[3:]]
        assert at == sorted(at)


@pytest.mark.parametrize("width", [80, 64])
def test_numbers_stand_below_the_end_of_their_heads(
    width: int, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", str(width))
    print_rows("a title", WIDE, ROWS)
    shown = lines(capsys)
    head = next(line for line in shown if line.rstrip().endswith("95 %"))
    row = next(line for line in shown if "0.60 to 1.42" in line)
    assert len(head) == len(row)


def test_a_table_of_no_rows_and_markup(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "64")
    print_rows("nothing", WIDE, [])
    print_rows("brackets", ["[b]name", *WIDE[1:]], [["[red]x", *ROWS[0][1:]]])
    assert "[red]x" in capsys.readouterr().out


def test_sentences_are_wrapped_where_the_width_is_known(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    text = "a sentence [of] many words " * 8
    print_sentences([text.strip()])
    assert lines(capsys) == [text.strip()]
    monkeypatch.setenv("COLUMNS", "60")
    print_sentences([text.strip()])
    shown = lines(capsys)
    assert max(map(len, shown)) <= 60
    assert " ".join(shown) == text.strip()
