"""Of lost samples, lost poses, a jump and a slew that one is taken by which the rates fit best."""

from types import SimpleNamespace

import pytest

from kreisel.preparation import clock_stages

STAGES = {"losses": "without_losses", "poses": "without_lost_poses", "slew": "without_slew", "jump": "without_jump"}


def chosen(monkeypatch, **left):
    """Return what is taken of stages that leave so much of a residual of one; others find nothing."""
    before = SimpleNamespace(fit=SimpleNamespace(residual_sd=1.0))
    found = {name: SimpleNamespace(fit=SimpleNamespace(residual_sd=one)) for name, one in left.items()}
    for name, stage in STAGES.items():
        nothing = before if name == "jump" else None
        own = found.get(name, nothing)
        monkeypatch.setattr(clock_stages, stage, lambda one, own=own: own if one is before else one)
    monkeypatch.setattr(clock_stages, "in_stated_seconds", lambda one: one)
    taken = clock_stages.repaired(before)
    return next((name for name, one in found.items() if one is taken), None)


@pytest.mark.parametrize(
    ("left", "expected"),
    [({}, None), ({"losses": 0.8}, "losses"), ({"jump": 0.8}, "jump"), ({"poses": 0.8}, "poses"),
     ({"slew": 0.8}, "slew"),
     ({"losses": 1.06}, "losses"), ({"losses": 0.84, "jump": 0.7}, "jump"), ({"losses": 0.72, "jump": 0.7}, "losses"),
     ({"jump": 0.786, "slew": 0.773}, "jump"), ({"jump": 0.9, "slew": 0.773}, "slew"),
     ({"poses": 0.7, "slew": 0.72}, "poses")],
)  # fmt: skip
def test_what_fits_best_is_taken(monkeypatch, left, expected):
    """Losses may hide behind a ratio of the clocks; of nearly equal ones the more likely one is taken."""
    assert chosen(monkeypatch, **left) == expected
