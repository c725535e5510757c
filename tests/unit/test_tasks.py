"""Tasks that do not depend on each other, run one after another and in threads."""

import pytest

from kreisel.cli.threads import in_threads
from kreisel.tasks import sequential


@pytest.mark.parametrize("executor", [sequential, in_threads])
def test_results_are_in_the_order_of_the_tasks(executor):
    assert executor([lambda i=i: i * i for i in range(7)]) == [i * i for i in range(7)]


@pytest.mark.parametrize("executor", [sequential, in_threads])
def test_the_first_error_is_raised(executor):
    def fail(text):
        raise ValueError(text)

    with pytest.raises(ValueError, match="second"):
        executor([lambda: 1, lambda: fail("second"), lambda: fail("third")])
