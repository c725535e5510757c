"""Where recordings of others are found, and how tests say that they are missing."""

import os
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

DATA = Path(os.environ.get("KREISEL_DATA", Path(__file__).resolve().parents[2] / "shared"))


@pytest.fixture(scope="session")
def recordings() -> Path:
    folder = DATA / "recordings"
    if not folder.is_dir():
        pytest.skip(f"no recordings at {folder}; set KREISEL_DATA to the folder that holds them")
    return folder


# Machines are shared: a deadline would measure that.
settings.register_profile("kreisel", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("kreisel")
