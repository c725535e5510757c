"""A minute of the small cell, made ready once."""

import pytest

from ...small_problem import prepared as prepared_for
from ...small_problem import recorded


@pytest.fixture(scope="session")
def cell():
    """What a small recording was made from, and what is known once it is prepared."""
    return recorded(60.0)[0], prepared_for(60.0)


@pytest.fixture(scope="session")
def prepared(cell):
    return cell[1]
