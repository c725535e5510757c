"""Fusion of results: against least squares over all data at once, which knows nothing of priors taken out."""

import numpy as np
import pytest

from kreisel.calibration.fusion import Contribution, Gaussian, conditioned, fuse, said_by, turned
from kreisel.estimation.state import Part, StateLayout
from kreisel.geometry.rotation import exp, matrix

from ...oracle import quaternions as quat


def posterior(A, y, prior):
    """Return the result of one data set y = A x + noise of unit variance."""
    information = A.T @ A + np.linalg.inv(prior.covariance)
    covariance = np.linalg.inv(information)
    return Gaussian(covariance @ (A.T @ y + np.linalg.solve(prior.covariance, prior.mean)), covariance)


def contribution(result, prior, predict=lambda u: u, columns=None, added=None):
    n = prior.mean.size
    return Contribution(
        result, prior, np.zeros((n, 0)) if columns is None else columns, np.zeros((n, n)) if added is None else added,
        predict,
    )  # fmt: skip


def random_prior(rng, n, scale=1.0):
    L = rng.normal(size=(n, n))
    return Gaussian(rng.normal(size=n), scale * (L @ L.T + np.eye(n)))


def test_what_data_say_is_found_again_without_the_prior():
    rng = np.random.default_rng(1)
    A, prior = rng.normal(size=(40, 6)), random_prior(rng, 6)
    y = rng.normal(size=40)
    said = said_by(contribution(posterior(A, y, prior), prior))
    np.testing.assert_allclose(said.H.T @ said.H, A.T @ A, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(said.H.T @ said.b, A.T @ y, rtol=1e-9, atol=1e-9)


def test_directions_of_which_data_say_nothing_are_left_out():
    rng = np.random.default_rng(2)
    A, prior = np.zeros((40, 6)), random_prior(rng, 6)
    A[:, :4] = rng.normal(size=(40, 4))
    result = posterior(A, rng.normal(size=40), prior)
    said = said_by(contribution(result, prior))
    assert len(said.b) == 4
    larger = said_by(contribution(result, prior, added=8.0 * result.covariance))
    assert len(larger.b) == 4
    assert np.trace(larger.H.T @ larger.H) < np.trace(said.H.T @ said.H) / 8.0
    unseen = np.linalg.svd(A)[2][4:]
    assert np.diag(unseen @ larger.excess @ unseen.T) == pytest.approx(
        8.0 * np.diag(unseen @ result.covariance @ unseen.T), rel=0.01
    )


def test_errors_that_are_added_to_results_make_them_count_less():
    """Results with added errors, fused, are as good as they say: over many draws."""
    rng, scores = np.random.default_rng(7), []
    prior = Gaussian(np.zeros(3), 4.0 * np.eye(3))
    layout = StateLayout([Part("x", 3)])
    E = np.diag([0.3, 0.02, 0.0]) ** 2
    for _ in range(400):
        x, said = 2.0 * rng.normal(size=3), []
        for _ in range(3):
            A = rng.normal(size=(30, 3))
            result = posterior(A, A @ x + rng.normal(size=30), prior)
            moved = result.mean + np.sqrt(np.diag(E)) * rng.normal(size=3)
            said.append(contribution(Gaussian(moved, result.covariance), prior, added=E))
        fused = fuse(said, layout, np.zeros(3), {"x": prior})
        error = fused.mean - x
        scores.append(error @ np.linalg.solve(fused.covariance, error) / 3)
    assert np.mean(scores) == pytest.approx(1.0, abs=0.1)


def test_errors_that_recordings_share_do_not_average_out():
    rng, scores = np.random.default_rng(8), []
    prior, columns = Gaussian(np.zeros(3), 1e4 * np.eye(3)), np.array([[0.5], [-0.2], [0.0]])
    layout = StateLayout([Part("x", 3), Part("e", 1)])
    known = {"x": prior, "e": Gaussian(np.zeros(1), np.eye(1))}
    for _ in range(300):
        x, e, said = rng.normal(size=3), rng.normal(size=1), []
        for _ in range(4):
            A = rng.normal(size=(60, 3))
            result = posterior(A, A @ x + rng.normal(size=60), prior)
            said.append(contribution(Gaussian(result.mean + columns @ e, result.covariance), prior, columns=columns))
        fused = fuse(said, layout, np.zeros(4), known)
        P = fused.covariance[:3, :3]
        error = fused.mean[:3] - x
        scores.append(error @ np.linalg.solve(P, error) / 3)
    assert np.mean(scores) == pytest.approx(1.0, abs=0.12)
    assert P[0, 0] == pytest.approx(0.25, rel=0.05)


def test_the_recording_that_differs_stands_out():
    rng = np.random.default_rng(9)
    prior, layout, x = Gaussian(np.zeros(4), 1e4 * np.eye(4)), StateLayout([Part("x", 4)]), rng.normal(size=4)
    said = []
    for k in range(4):
        A = rng.normal(size=(50, 4))
        wrong = np.array([0.0, 0.0, 2.0, 0.0]) if k == 2 else 0.0
        said.append(contribution(posterior(A, A @ (x + wrong) + rng.normal(size=50), prior), prior))
    misfits = fuse(said, layout, np.zeros(4), {"x": prior}).misfits
    assert np.argmax([one.largest for one in misfits]) == 2
    assert misfits[2].largest > 8.0
    assert all(one.degrees == 4 for one in misfits)


def test_recordings_with_numbers_of_their_own_fit_as_all_data_at_once():
    rng = np.random.default_rng(3)
    common, own, runs = 5, 3, 3
    shared, ownprior = random_prior(rng, common, 4.0), random_prior(rng, own)
    A = [rng.normal(size=(30, common + own)) for _ in range(runs)]
    x = rng.normal(size=common)
    y = [a @ np.concatenate([x, rng.normal(size=own)]) + rng.normal(size=30) for a in A]
    prior = Gaussian(
        np.concatenate([shared.mean, ownprior.mean]),
        np.block([[shared.covariance, np.zeros((common, own))], [np.zeros((own, common)), ownprior.covariance]]),
    )
    results = [posterior(a, b, prior) for a, b in zip(A, y, strict=True)]
    index = np.arange(common)
    part = [Gaussian(r.mean[:common], r.covariance[:common, :common]) for r in results]
    layout = StateLayout([Part("x", common)])
    fused = fuse([contribution(p, shared) for p in part], layout, part[0].mean, {"x": shared})

    # all unknowns in one problem: the common ones, then each recording's own
    n = common + runs * own
    M, v = np.zeros((n, n)), np.zeros(n)
    M[:common, :common] += np.linalg.inv(shared.covariance)
    v[:common] += np.linalg.solve(shared.covariance, shared.mean)
    for i, (a, b) in enumerate(zip(A, y, strict=True)):
        d = np.r_[:common, common + i * own : common + (i + 1) * own]
        M[np.ix_(d, d)] += a.T @ a
        v[d] += a.T @ b
        o = d[common:]
        M[np.ix_(o, o)] += np.linalg.inv(ownprior.covariance)
        v[o] += np.linalg.solve(ownprior.covariance, ownprior.mean)
    covariance, mean = np.linalg.inv(M), np.linalg.solve(M, v)
    np.testing.assert_allclose(fused.mean, mean[:common], rtol=1e-8)
    np.testing.assert_allclose(fused.covariance, covariance[:common, :common], rtol=1e-7)
    for i, result in enumerate(results):
        d = np.r_[:common, common + i * own : common + (i + 1) * own]
        step, P = conditioned(result, index, part[i], fused.parts[i])
        np.testing.assert_allclose(result.mean + step, mean[d], rtol=1e-7)
        np.testing.assert_allclose(P, covariance[np.ix_(d, d)], rtol=1e-6, atol=1e-12)
    assert fused.degrees == runs * common + common - common


def test_chi_square_is_that_of_independent_results():
    rng, values = np.random.default_rng(4), []
    prior = Gaussian(np.zeros(4), 1e6 * np.eye(4))
    layout = StateLayout([Part("x", 4)])
    for _ in range(300):
        x = rng.normal(size=4)
        said = []
        for _ in range(3):
            A = rng.normal(size=(12, 4))
            result = posterior(A, A @ x + rng.normal(size=12), prior)
            said.append(contribution(result, prior))
        fused = fuse(said, layout, np.zeros(4), {"x": prior})
        values.append(fused.chi_square)
    assert fused.degrees == 12
    # the prior's four residuals are nearly zero
    assert np.mean(values) == pytest.approx(8.0, abs=0.7)
    assert np.var(values) == pytest.approx(16.0, rel=0.35)


def test_mounts_are_found_and_cost_what_they_must():
    rng = np.random.default_rng(5)
    K_w, K_a, arms = (
        np.eye(3) + rng.normal(0, 0.02, (3, 3)),
        np.eye(3) + rng.normal(0, 0.02, (3, 3)),
        rng.normal(0, 0.05, (3, 3)),
    )
    names = ("gyro_cross_coupling", "accel_cross_coupling", "lever_arms")
    device = dict(zip(names, (K_w.ravel(), K_a.ravel(), arms.ravel()), strict=True))
    q, shift = quat.exp(np.array([0.4, -0.2, 0.7])), np.array([0.1, -0.05, 0.02])
    there = turned(device, q, shift)
    C = quat.matrix(q)
    np.testing.assert_allclose(there["gyro_cross_coupling"].reshape(3, 3), C @ K_w, atol=1e-14)
    np.testing.assert_allclose(there["lever_arms"].reshape(3, 3)[1], C @ arms[1] + shift, atol=1e-14)

    sd = 1e-3
    prior = Gaussian(np.zeros(27), 1e4 * np.eye(27))
    layout = StateLayout([*(Part(name, 9) for name in names), Part("turn", 3, rotation=True), Part("shift", 3)])

    def at(u, moved):
        values = {name: u[layout.stored(name)] for name in names}
        if moved:
            values = turned(values, u[layout.stored("turn")], u[layout.stored("shift")])
        return np.concatenate(list(values.values()))

    truth = np.concatenate([*device.values(), q, shift])
    scores = []
    known = {name: Gaussian(np.zeros(9), 1e4 * np.eye(9)) for name in names}
    known |= {"turn": Gaussian(np.zeros(3), np.eye(3)), "shift": Gaussian(np.zeros(3), np.eye(3))}
    for _ in range(40):
        said = [
            contribution(
                Gaussian(at(truth, m) + sd * rng.normal(size=27), sd**2 * np.eye(27)), prior, lambda u, m=m: at(u, m)
            )
            for m in (False, True)
        ]
        start = np.concatenate([said[0].filtered.mean, quat.multiply(q, exp(0.05 * rng.normal(size=3))), np.zeros(3)])
        fused = fuse(said, layout, start, known)
        error = layout.minus(truth[:, None], fused.mean)[:, 0]
        scores.append(error @ np.linalg.solve(fused.covariance, error) / layout.degrees)
    assert np.mean(scores) == pytest.approx(1.0, abs=0.12)
    # 54 numbers for 33 unknowns: six of the device's 27 are seen once, along the mount, and the others twice
    share = np.diag(fused.covariance)[:27].sum() / sd**2
    assert 27 / 2 < share < 27
    assert share == pytest.approx((21 + 2 * 6) / 2, rel=0.1)
    np.testing.assert_allclose(matrix(fused.mean[layout.stored("turn")]), C, atol=5e-3)
