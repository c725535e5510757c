import pytest
from scipy.stats import chi2

from kreisel.estimation.consistency import chi_square, gate_bound


@pytest.mark.parametrize("degrees", range(1, 13))
@pytest.mark.parametrize("tail", [0.5, 0.05, 1e-3, 1e-6, 1e-12])
def test_gate_is_the_chi_square_quantile(degrees: int, tail: float) -> None:
    assert gate_bound(tail, degrees) == pytest.approx(chi2.isf(tail, degrees), rel=1e-9)


def test_chi_square_is_the_other_tail() -> None:
    assert chi_square(0.975, 6) == pytest.approx(chi2.ppf(0.975, 6), rel=1e-9)
