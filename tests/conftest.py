"""Where recordings of others are found, and how tests say that they are missing."""

import os
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

from kreisel.filtering.compile_kernels import compile_kernels

DATA = Path(os.environ.get("KREISEL_DATA", Path(__file__).resolve().parents[2] / "shared"))


@pytest.fixture(scope="session")
def recordings() -> Path:
    folder = DATA / "recordings"
    if not folder.is_dir():
        pytest.skip(f"no recordings at {folder}; set KREISEL_DATA to the folder that holds them")
    return folder


# Kernels compile on their first call, and machines are shared: time would measure that.
settings.register_profile("kreisel", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("kreisel")


def pytest_configure(config: pytest.Config) -> None:
    """Compile the kernels once, before workers start: what is loaded from one cache gives one result everywhere."""
    if not hasattr(config, "workerinput"):
        compile_kernels()
