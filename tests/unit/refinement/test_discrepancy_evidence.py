"""Evidence for families of terms, against the density of the data itself in a linear model, and against chance."""

from dataclasses import replace

import numpy as np
import pytest

from kreisel.fitting.terms import Linearisation, Scores
from kreisel.refinement import discrepancy_evidence
from kreisel.refinement.discrepancy_evidence import (
    _alone,
    _gains,
    _predicted,
    _predicted_without_each,
    _prepared,
    _solved,
    undecided,
    weigh,
    worth_weighing,
)

ROWS, PARAMETERS, FAMILIES, EACH, PARTS = 400, 4, 5, 6, 20
FAMILY = np.repeat(np.arange(FAMILIES), EACH)
WEIGHT = np.tile(1.0 / np.arange(1, EACH + 1), FAMILIES)


@pytest.fixture(scope="module")
def designs():
    rng = np.random.default_rng(3)
    return rng.normal(size=(ROWS, PARAMETERS)), rng.normal(size=(ROWS, FAMILIES * EACH))


def linearised(X, Z, y):
    """Return what y = X p + Z b + noise of unit variance says of b, with a flat prior of p."""
    P = np.linalg.inv(X.T @ X)
    rest = y - X @ (P @ (X.T @ y))
    free = Z - X @ (P @ (X.T @ Z))
    parts = [slice(i, i + ROWS // PARTS) for i in range(0, ROWS, ROWS // PARTS)]
    information = np.stack([free[part].T @ free[part] for part in parts])
    scores = np.stack([free[part].T @ rest[part] for part in parts])
    misfit, degrees = float(rest @ rest), float(ROWS - PARAMETERS)
    return Linearisation(-P @ X.T @ Z, free.T @ free, free.T @ rest, information, scores, misfit, degrees)


def log_density(X, Z, y, variance):
    """Return the logarithm of the density of y, less its parameters, for variances of amplitudes, up to a constant."""
    free = np.linalg.svd(X)[0][:, PARAMETERS:]  # orthogonal to the parameters' columns
    C = np.eye(ROWS - PARAMETERS) + (free.T @ Z * variance) @ Z.T @ free
    rest = free.T @ y
    return -0.5 * rest @ np.linalg.solve(C, rest) - 0.5 * np.linalg.slogdet(C)[1]


def test_the_gain_is_the_ratio_of_densities(designs):
    X, Z = designs
    rng = np.random.default_rng(0)
    y = X @ rng.normal(size=PARAMETERS) + 0.3 * Z[:, :EACH] @ rng.normal(size=EACH) + rng.normal(size=ROWS)
    data = _prepared(linearised(X, Z, y), FAMILY, WEIGHT, 1.0)
    plain = log_density(X, Z, y, np.zeros(FAMILY.size))
    for f in (0, 3):
        gain, size = _alone(data, f)
        variance = np.where(f == FAMILY, size * (data.expected * data.unit) ** 2, 0.0)
        assert gain == pytest.approx(log_density(X, Z, y, variance) - plain, abs=1e-6)
        assert all(gain >= log_density(X, Z, y, factor * variance) - plain - 1e-9 for factor in (0.3, 3.0))


def test_a_family_gains_beside_others_what_it_adds_to_the_density(designs):
    X, Z = designs
    rng = np.random.default_rng(1)
    y = 0.2 * Z[:, : 2 * EACH] @ rng.normal(size=2 * EACH) + rng.normal(size=ROWS)
    data = _prepared(linearised(X, Z, y), FAMILY, WEIGHT, 1.0)
    sizes = np.array([4.0, 9.0, 1.0, 0.0, 0.0])
    gains = _gains(data, _solved(data, sizes, 1.0))
    prior = sizes[FAMILY] * (data.expected * data.unit) ** 2
    for f in range(3):
        more = log_density(X, Z, y, prior) - log_density(X, Z, y, np.where(f == FAMILY, 0.0, prior))
        assert gains[f] == pytest.approx(more, abs=1e-6)


def test_families_that_are_there_are_chosen_and_corrected(designs):
    X, Z = designs
    rng, errors, expected = np.random.default_rng(2), [], []
    for _ in range(60):
        b = np.where(FAMILY < 2, 0.5 * WEIGHT * rng.normal(size=FAMILY.size), 0.0)
        y = Z @ b + rng.normal(size=ROWS)
        found = linearised(X, Z, y)
        weighed = weigh(found, FAMILY, WEIGHT)
        assert not weighed.chosen[2:].any()
        estimate = np.linalg.lstsq(X, y, rcond=None)[0] + found.change @ weighed.amplitude
        errors.append(estimate**2)
        spread = found.change @ weighed.covariance @ found.change.T
        expected.append(np.diag(np.linalg.inv(X.T @ X) + spread))
    assert np.sum(errors) == pytest.approx(np.sum(expected), rel=0.25)


def test_where_there_is_nothing_nothing_is_chosen(designs):
    X, Z = designs
    rng, gains = np.random.default_rng(4), []
    for _ in range(300):
        weighed = weigh(linearised(X, Z, rng.normal(size=ROWS)), FAMILY, WEIGHT)
        assert not weighed.chosen.any()
        assert not weighed.amplitude.any()
        gains.append(weighed.gain.max())
    assert np.median(gains) < 1.5  # the largest of five


def test_noise_larger_than_assumed_is_no_family(designs):
    X, Z = designs
    rng = np.random.default_rng(5)
    for _ in range(30):
        weighed = weigh(linearised(X, Z, 4.0 * rng.normal(size=ROWS)), FAMILY, WEIGHT)
        assert not weighed.chosen.any()
        assert weighed.noise == pytest.approx(16.0, rel=0.4)


def test_noise_that_lasts_is_no_family_although_functions_follow_it(designs, monkeypatch):
    """Waves that are slow beside the noise's correlation follow it in every part, and predict none."""
    X, _ = designs
    rng, t = np.random.default_rng(6), np.linspace(0.0, 1.0, ROWS)
    Z, even = np.cos(np.pi * np.outer(t, np.arange(40, 40 + FAMILY.size))), np.ones(FAMILY.size)
    noise = np.zeros(ROWS)
    for i in range(1, ROWS):
        noise[i] = 0.8 * noise[i - 1] + rng.normal()
    found = linearised(X, Z, noise)
    assert not weigh(found, FAMILY, even).chosen.any()
    monkeypatch.setattr(discrepancy_evidence, "MIN_PREDICTED", -np.inf)
    assert weigh(found, FAMILY, even).chosen.any()


def test_a_family_that_may_be_there_counts_with_its_probability(designs):
    X, Z = designs
    rng = np.random.default_rng(8)
    found = linearised(X, Z, rng.normal(size=ROWS))
    hint = replace(found, score=found.score + found.information[:, 0] * 0.15)
    plain, hinted = (undecided(one.change, weigh(one, FAMILY, WEIGHT)) for one in (found, hint))
    assert np.sum(plain**2) < 0.05 * np.trace(np.linalg.inv(X.T @ X))  # an honest recording pays nothing
    assert np.sum(hinted**2) > 2.0 * np.sum(plain**2)


def test_a_rare_family_that_may_be_there_counts_less(designs):
    X, Z = designs
    rng = np.random.default_rng(8)
    found = linearised(X, Z, rng.normal(size=ROWS))
    weighed = weigh(replace(found, score=found.score + found.information[:, 0] * 0.15), FAMILY, WEIGHT)
    usual, rare = (undecided(found.change, weighed, odds) for odds in (0.02, np.full(FAMILIES, 0.001)))
    assert 0.04 < np.sum(rare**2) / np.sum(usual**2) < 0.2


def scored(X, Z, y, rng):
    free = Z - X @ np.linalg.lstsq(X, Z, rcond=None)[0]
    return Scores(free.T @ y, rng.normal(size=(32, ROWS)) @ free)


def test_families_that_gain_are_worth_weighing_and_few_others(designs):
    """What a screening by scores leaves out, the evidence of all would have left out too."""
    X, Z = designs
    rng, looked_at, missed = np.random.default_rng(6), 0, 0
    for _ in range(60):
        y = rng.normal(size=ROWS)
        true = int(rng.integers(FAMILIES))
        if rng.random() < 0.5:
            y += Z[:, true == FAMILY] @ (0.15 * rng.normal(size=EACH))
        worth = worth_weighing(scored(X, Z, y, rng), FAMILY, WEIGHT)
        found = set(weigh(linearised(X, Z, y), FAMILY, WEIGHT).families)
        missed += len(found - set(worth.tolist()))
        looked_at += len(set(worth.tolist()) - {true})
    assert missed == 0
    assert looked_at < 0.25 * 60 * (FAMILIES - 1)


def test_one_strong_term_makes_its_family_worth_weighing(designs):
    X, Z = designs
    rng = np.random.default_rng(8)
    y = rng.normal(size=ROWS) + 0.35 * Z[:, 9]
    assert FAMILY[9] in worth_weighing(scored(X, Z, y, rng), FAMILY, WEIGHT)


def test_what_all_families_but_one_predict_is_what_they_predict_alone(designs):
    X, Z = designs
    rng = np.random.default_rng(8)
    y = 0.4 * Z[:, : 2 * EACH] @ rng.normal(size=2 * EACH) + rng.normal(size=ROWS)
    data = _prepared(linearised(X, Z, y), FAMILY, WEIGHT, 1.0)
    families = np.array([0, 1, 4])
    state = _solved(data, np.where(np.isin(np.arange(FAMILIES), families), 0.5, 0.0), 1.2)
    whole, without = _predicted_without_each(data, state, families)
    assert whole == pytest.approx(_predicted(data, state, families), rel=1e-9)
    for f, found in zip(families, without, strict=True):
        assert found == pytest.approx(_predicted(data, state, families[families != f]), rel=1e-9)
    assert without[2] > without[:2].max()
