"""What accelerometers make felt, against matrices, and its double integrals against those of columns."""

import numpy as np

from kreisel._kernels import quadrature, unit_forces
from kreisel.geometry.rotation import exp, matrix, skew


def some(n: int = 60) -> tuple[np.ndarray, ...]:
    rng = np.random.default_rng(4)
    return exp(rng.normal(0, 1, (n, 3))), *(rng.normal(0, s, (n, 3)) for s in (9.0, 2.0, 5.0))


def columns(q: np.ndarray, a: np.ndarray, omega: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """The same written with matrices, (n, 3, 15)."""
    C = matrix(q)
    turning = skew(alpha) + skew(omega) @ skew(omega)
    couplings = np.einsum("nij,nk->nijk", C, a).reshape(-1, 3, 9)
    return np.concatenate([couplings, C, -C @ turning], axis=2)


def test_every_column_is_that_of_the_sensor_model() -> None:
    sampled = some()
    out = np.empty(3 * unit_forces.PARAMETERS)
    for k, expected in enumerate(columns(*sampled)):
        unit_forces.at_sample(*(part[k] for part in sampled), out)
        np.testing.assert_allclose(out.reshape(3, 15), expected, atol=1e-12)


def test_double_integrals_are_those_of_the_columns() -> None:
    rng = np.random.default_rng(5)
    sampled, stamps = some(), np.cumsum(rng.uniform(0.002, 0.003, 60))
    before = np.array([0, 3, 3, 20, 58])
    share = np.array([0.0, 0.2, 0.9, 0.5, 1.0])
    got = np.empty((5, 45))
    unit_forces.double_integrals(stamps, *sampled, before, share, got)
    for c in range(15):
        expected = np.empty((5, 3))
        quadrature.double_integral(stamps, np.ascontiguousarray(columns(*sampled)[:, :, c]), before, share, expected)
        np.testing.assert_allclose(got.reshape(5, 3, 15)[:, :, c], expected, rtol=1e-12, atol=1e-15)
