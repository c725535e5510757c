"""`kreisel gauge`: repeatability and reproducibility of a calibration line."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from kreisel.cli import completion

if TYPE_CHECKING:
    from kreisel.batch.gauge_study import Gauged


def gauge(
    database: Path = typer.Argument(..., help="File of results of `kreisel batch` or `kreisel station`."),
    output: Path | None = typer.Option(None, "-o", "--output", help="Page to write, .html."),
    limits: str | None = typer.Option(
        None, help="Limits: a TOML file with [limits], or a grade.", autocompletion=completion.grades
    ),
    by: str = typer.Option(
        "operator",
        "--by",
        help="Key of [certificate] or [device] that says who calibrated.",
        autocompletion=completion.one_of(completion.FIELDS),
    ),
    json: bool = typer.Option(False, "--json", help="Print the study as one JSON object."),
) -> None:
    """Study a gauge: calibrations of some units, each several times, by one appraiser or several."""
    import json as json_module

    from kreisel.batch.gauge_study import (
        APPRAISERS,
        appraiser_of,
        counted_once,
        gauge_facts,
        gauge_study,
        gauge_table,
    )
    from kreisel.batch.result_store import Store
    from kreisel.calibration.limits import limits_named
    from kreisel.cli.terminal_tables import print_rows
    from kreisel.errors import RecordingError, SettingsError, unknown_name

    if by not in APPRAISERS:
        raise SettingsError(unknown_name("key after --by", by, APPRAISERS))
    known = None if limits is None else limits_named(limits)
    if not database.is_file():
        raise RecordingError("no such file; `kreisel batch` makes it", file=database)
    with Store(database) as store:
        runs = counted_once([run for run in store.runs() if run.accepted])
    found = gauge_study(runs, known, by)
    names = sorted({appraiser_of(run, by) for run in runs})
    lead = (
        f"{len({run.device for run in runs})} units, {len(runs)} calibrations; {by}: {', '.join(names) or 'not stated'}"
    )
    if output is not None:
        from kreisel.files import write_whole
        from kreisel.report.template import fill

        shown = {"title": "Gauge study", "lead": lead, "table_of_groups": gauge_table(found), "figures": []}
        write_whole(output, fill("study.html", [], facts=gauge_facts(found), **shown))
    if json:
        typer.echo(json_module.dumps({"runs": len(runs), "by": by, "appraisers": names, "figures": _document(found)}))
        return
    table = gauge_table(found)
    print_rows(lead, table.columns, [list(row.cells) for row in table.rows])
    for fact in gauge_facts(found):
        typer.echo(f"· {fact}")
    if output is not None:
        typer.echo(f"written: {output}")


def _document(found: list[Gauged]) -> list[dict[str, Any]]:
    import math
    from dataclasses import asdict

    from kreisel.batch.lot import label_of

    return [
        {
            "name": one.quantity.name,
            "axis": label_of(one.quantity, one.axis),
            "unit": one.quantity.unit,
            **asdict(one.components),
            "gauge": one.components.gauge,
            "categories": one.components.categories,
            "stated_deviation": one.calibration_sd,
            "of_tolerance": one.of_tolerance if math.isfinite(one.of_tolerance) else None,
        }
        for one in found
    ]
