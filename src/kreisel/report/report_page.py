"""The page itself: one HTML file that needs only a browser."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from kreisel.calibration.evidence import Injection
from kreisel.calibration.outcome import Outcome
from kreisel.model.considered_terms import MIN_GAIN
from kreisel.report import figures, report_tables, result_tables
from kreisel.report.budget_figure import budget_picture
from kreisel.report.data import ReportData, extract
from kreisel.report.improvement import improvement_table
from kreisel.report.influence import influence_figures, influence_of, splits_figures
from kreisel.report.plots import Figure
from kreisel.report.reader_names import by_quantity, unobservable_table
from kreisel.report.snippet import snippet
from kreisel.report.template import fill


def write_report(
    outcome: Outcome,
    path: Path,
    *,
    injection: Injection | None = None,
) -> None:
    """Write the report of a calibration as one HTML file that works offline.

    Parameters
    ----------
    injection
        Validations; the report names the missing ones.
    """
    Path(path).write_text(render(extract(outcome, injection)), encoding="utf-8")


def render(data: ReportData) -> str:
    """Return the page."""
    drawn = _figures(data)
    return fill(
        "report.html",
        [f for part in drawn.values() for f in part],
        document=data.outcome.calibration.document,
        title=data.outcome.calibration.recording.title if data.outcome.calibration.recording else "IMU",
        warnings=report_tables.ranked(data.outcome.warnings),
        verdict=data.outcome.verdict,
        unobservable=by_quantity(data.outcome.observability.unobservable),
        lost=unobservable_table(data.outcome),
        not_estimated=report_tables.not_estimated(data.outcome),
        figures=drawn,
        min_gain=MIN_GAIN,
        snippet=snippet(
            data.outcome.calibration.sensors,
            data.outcome.calibration.size_effect,
            data.outcome.recording.imu.usual_temperature,
        ),
        **_tables(data),
    )


def _figures(data: ReportData) -> dict[str, list[Figure]]:
    groups = dict(zip(data.uncertainty.names, data.uncertainty.groups, strict=True))
    estimated = bool(data.uncertainty.names)
    return {
        "excitation": figures.excitation_figures(data.excitation),
        "residuals": figures.residual_figures(data.residuals),
        "difference": figures.difference_figures(data.difference),
        "tracks": figures.track_figures(data.uncertainty),
        "correlations": [figures.matrix_figure(data.uncertainty)] if estimated else [],
        "drift": [] if data.unseen is None else figures.drift_figures(data.unseen),
        "influence": influence_figures(influence_of(data.outcome)),
        "splits": splits_figures(data.outcome.splits),
        "halves": [] if data.halves is None else [figures.halves_figure(data.halves, groups)],
    }


def _tables(data: ReportData) -> dict[str, Any]:
    groups = dict(zip(data.uncertainty.names, data.uncertainty.groups, strict=True))
    outcome = data.outcome
    return {
        "keys": result_tables.key_tables(outcome),
        "device": result_tables.device_tables(outcome.calibration),
        "rejected": report_tables.rejected_table(outcome),
        "excitation_table": report_tables.excitation_table(data.excitation),
        "clock_table": report_tables.clock_table(outcome, data.excitation),
        "excitation": data.excitation,
        "nis_table": report_tables.nis_table(data.residuals),
        "noise_table": report_tables.noise_table(outcome),
        "cause_table": report_tables.cause_table(data.difference),
        "robot_tables": report_tables.robot_tables(outcome),
        "budget": budget_picture(outcome),
        "improvement": improvement_table(outcome),
        "free_navigation": None if data.unseen is None else report_tables.free_navigation_table(data.unseen),
        "parameter_table": report_tables.parameter_table(data),
        "considered_table": report_tables.considered_table(outcome),
        "drift_table": None if data.unseen is None else report_tables.drift_table(data.unseen),
        "unseen": data.unseen,
        "scores": None if data.halves is None else report_tables.score_summary(data.halves),
        "injection_table": None if data.injection is None else report_tables.injection_table(data.injection, groups),
    }
