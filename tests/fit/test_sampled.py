"""Intervals by samples: those of the matrix, as far as samples know them, and where there are none."""

from dataclasses import asdict

import numpy as np
import pytest
from helpers.marks import FITS
from helpers.scenes import trial
from scipy import stats

from clothfit.cli.parts.estimate_results import certainty
from clothfit.fit import sampled
from clothfit.fit.estimate import estimate, record_target
from clothfit.fit.posterior import half_width
from clothfit.motion.degrade import degrade
from clothfit.optimise import trajectory
from clothfit.report.findings import by_samples
from clothfit.scene.scene import load

pytestmark = FITS

K = sampled.SAMPLES


@pytest.fixture
def noisy():
    """A scene and a noisy target of its own motion."""
    made = load(trial("nL", 40))
    return made, degrade(record_target(made), 1e-3, observed=0.8, seed=1)


def ends(found):
    """The intervals (P, 2), NaN where there is none."""
    return np.array([pair or (np.nan, np.nan) for block in found.parameters for pair in block.interval])


def by_products(monkeypatch, scene, target, **options):
    """A fit whose confidence may use no matrix."""
    monkeypatch.setattr(trajectory, "LARGEST", 0.0)
    return estimate(scene, target, start=20.0, prior=0.5, **options)


def test_they_are_those_of_the_matrix_as_far_as_samples_know(monkeypatch, noisy):
    scene, target = noisy
    exact = estimate(scene, target, start=20.0, prior=0.5)
    found = by_products(monkeypatch, scene, target)
    assert exact.samples is None
    assert found.samples == sampled.Samples(K, pytest.approx(1.0 / np.sqrt(2.0 * K)))
    assert found.cost == pytest.approx(exact.cost, rel=1e-9)  # the fit itself is the same
    assert found.sigma == pytest.approx(exact.sigma, rel=1e-2)  # by a γ of samples, of some 1,300 residuals
    known = np.isfinite(ends(exact)).all(axis=1)
    np.testing.assert_array_equal(np.isfinite(ends(found)).all(axis=1), known)
    mine, theirs = (np.log(pairs[known, 1] / pairs[known, 0]) / 2.0 for pairs in (ends(found), ends(exact)))
    ratio = mine / half_width(K) / (theirs / half_width(1e3))
    low, high = stats.chi2.ppf([1e-5 / len(ratio), 1 - 1e-5 / len(ratio)], K) / K
    # what the last round left, a twentieth of a deviation, and the step that is left, up to a fifth of one
    assert (ratio > 0.9 * np.sqrt(low)).all()
    assert (ratio < 1.2 * np.sqrt(high)).all()


def test_they_say_so_wherever_intervals_are_shown(monkeypatch, noisy):
    found = by_products(monkeypatch, *noisy)
    text = certainty(found.parameters[0], found.samples)
    assert text.endswith(f"(median 95 % interval, by {K} samples, to 18 %)")
    assert "samples" not in certainty(found.parameters[0])
    given = {"samples": asdict(found.samples)}
    assert by_samples(given) == f"the intervals are by {K} samples of the posterior, to 18%"
    for wrong in (None, [], {}, {"count": K}, {"count": "x", "accuracy": 0.1}, {"count": 16, "accuracy": 1e400}):
        assert by_samples({"samples": wrong}) == ""


def test_without_a_prior_there_are_none(monkeypatch, noisy):
    monkeypatch.setattr(trajectory, "LARGEST", 0.0)
    found = estimate(*noisy, start=20.0, prior="none")
    assert found.samples is None
    assert np.isnan(ends(found)).all()
    assert any(text.startswith("no intervals") for text in found.warnings)


def test_where_the_time_is_up_before_they_have_settled_there_are_none(monkeypatch, noisy):
    monkeypatch.setattr(sampled, "SHARE", 0.0)
    monkeypatch.setattr(sampled, "LEAST", 0.0)
    found = by_products(monkeypatch, *noisy)
    assert found.samples is None
    assert any(text.startswith("no intervals") for text in found.warnings)


def test_a_request_ends_them_and_keeps_the_fit(monkeypatch, noisy):
    stages = []

    def end(progress):
        stages.append(progress.stage)
        if progress.stage == "intervals":
            raise KeyboardInterrupt

    found = by_products(monkeypatch, *noisy, on_progress=end)
    assert stages[-1] == "intervals"
    assert found.status in ("converged", "stalled")
    assert found.samples is None
    assert found.rmse < 2.5e-3  # noise of 1 mm in three directions
    assert any("interrupted" in text for text in found.warnings)
