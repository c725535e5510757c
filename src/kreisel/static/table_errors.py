"""Errors of a turntable's angles, where the data show them: a gear's play, and an encoder that is not centred."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from kreisel.model.considered_terms import MIN_GAIN, USUAL_ODDS
from kreisel.progress import Progress, of_step
from kreisel.recording.recording import DataWarning
from kreisel.static.known_attitudes import TableTurns
from kreisel.static.multi_position import StaticEstimate, estimate_static, undecided_by
from kreisel.static.rest_problem import nuisance
from kreisel.static.static_methods import Chosen
from kreisel.units import MRAD

_PLAY = 3e-3
"""rad; deviation of the play of a turntable's gear. Chosen: worm gears have some arc minutes, worn ones a quarter of a
degree."""

_WAVES = 2e-3
"""rad; deviation of each wave of an encoder's error. Chosen: a disc of 50 mm that is 0.05 mm off its centre."""

_LOOSE = "the turntable's angles are off by a play of {size:.2g} mrad wherever it turns back; that is estimated"
_UNCENTRED = (
    "the turntable's angles are off by up to {size:.2g} mrad in waves once and twice a revolution, as by a disc of the "
    "encoder that is not centred; that is estimated"
)
"""What is said of such turntables."""

_LEAST_TURNS = 8
"""Turns of a table by which waves are considered: they are four parameters, and the axis two. Chosen."""


def with_table_errors(
    chosen: Chosen, found: StaticEstimate, progress: Progress | None
) -> tuple[Chosen, StaticEstimate]:  # fmt: skip
    """Return method and estimate with errors of a turntable's angles that the data show.

    An encoder on the motor's side counts a gear's play wherever the table turns back; one that is not centred is off by
    waves. Where the data do not decide, what such an error would do to the parameters counts by its probability.
    """
    left = _possible(chosen)
    while left:
        trials = {name: _fitted(chosen, name, progress) for name in left}
        best = max(trials, key=lambda name: trials[name][1].log_evidence)
        if trials[best][1].log_evidence - found.log_evidence < MIN_GAIN:
            undecided = [undecided_by(found, other, USUAL_ODDS) for _, other in trials.values()]
            return chosen, replace(found, undecided=np.hstack([found.undecided, *undecided]))
        chosen, found = trials[best]
        left = [name for name in left if name != best]
        said = DataWarning("method", _said(best, found))
        chosen = replace(chosen, warnings=(*chosen.warnings, said))
    return chosen, found


def _possible(chosen: Chosen) -> list[str]:
    """Return the errors that a table's turns could show."""
    table = _table_of(chosen)
    if table is None:
        return []
    waves = len(table.waves) >= _LEAST_TURNS and bool(np.ptp(table.waves, axis=0).any())
    return [name for name, shown in (("play_sd", table.reversed.any()), ("waves_sd", waves)) if shown]


def _table_of(chosen: Chosen) -> TableTurns | None:
    return next((one for one in chosen.problem.known if isinstance(one, TableTurns)), None)


def _fitted(chosen: Chosen, name: str, progress: Progress | None) -> tuple[Chosen, StaticEstimate]:
    """Return method and estimate with one more error of the angles."""
    known = tuple(_with(one, name) if isinstance(one, TableTurns) else one for one in chosen.problem.known)
    more = replace(chosen, problem=replace(chosen.problem, known=known))
    return more, estimate_static(more.problem, chosen.start, of_step(progress, "fit"), chosen.attitudes)


def _with(table: TableTurns, name: str) -> TableTurns:
    return replace(table, play_sd=_PLAY) if name == "play_sd" else replace(table, waves_sd=_WAVES)


def _said(name: str, found: StaticEstimate) -> str:
    if name == "play_sd":
        return _LOOSE.format(size=abs(float(nuisance(found.parameters, "table_play", 1)[0])) / MRAD)
    angle = np.linspace(0.0, 2.0 * np.pi, 721)[:, None] * np.array([1.0, 2.0])
    parts = np.stack([np.cos(angle), np.sin(angle)], axis=2).reshape(-1, 4)
    error = parts @ nuisance(found.parameters, "table_waves", 4)
    return _UNCENTRED.format(size=0.5 * float(np.ptp(error)) / MRAD)
