"""What helping processes compile is what the filter loads."""

import pytest

from kreisel._kernels import (
    composition,
    filter_loop,
    measurement_model,
    preintegration,
    process_model,
    sensor_noise,
    sigma_point_filter,
)
from kreisel.filtering import compile_kernels as kernels


@pytest.mark.parametrize(
    "kernel",
    [
        process_model.sensor_coefficients, preintegration.preintegrate, sigma_point_filter.draw,
        sigma_point_filter.update, composition.compose, sensor_noise.noise_covariance, sensor_noise.navigation_noise,
        measurement_model.predict_poses,
    ],
)  # fmt: skip
def test_nothing_is_compiled_twice(kernel):
    kernels._filter()
    for works in kernels._ASIDE.values():
        for compile_some in works:
            compile_some()
    assert len(kernel.signatures) == 1


def test_what_a_helper_leaves_is_compiled_here(monkeypatch):
    monkeypatch.setattr(kernels.compilation, "is_cold", lambda function: True)
    monkeypatch.setattr(kernels, "_ROUNDS", (("no such work",),))
    shares = []
    kernels.compile_kernels(shares.append)
    assert shares
    assert shares[-1] == 1.0
    assert filter_loop.run.signatures
