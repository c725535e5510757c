import pytest
from scipy.stats import chi2

from kreisel.estimation.consistency import chi_square_bound


@pytest.mark.parametrize("degrees", [*range(1, 13), 0.5, 37.5, 120, 6000, 1_000_000])
@pytest.mark.parametrize("tail", [1.0 - 1e-6, 0.999, 0.975, 0.5, 0.05, 1e-3, 1e-6, 1e-12])
def test_the_bound_is_exceeded_with_the_tails_probability(degrees: float, tail: float) -> None:
    assert chi_square_bound(tail, degrees) == pytest.approx(chi2.isf(tail, degrees), rel=1e-9)
