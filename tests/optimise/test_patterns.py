"""The patterns of a fabric: families, smooth maps, their size; and a prior of them that finds values by few data."""

import numpy as np
import pytest
from helpers.strangers import sheet

from clothfit.optimise.prior import first, patterns
from clothfit.scene.families import spring_groups

NOISE = 1e-3


def of_sheet(chosen=None):
    """The patterns of the springs of a sheet, some of them."""
    scene = sheet(letters="nL")
    (block,) = scene.blocks
    own = np.arange(block.count) if chosen is None else chosen
    return scene.cloths[0], patterns(scene.cloths[0], block, own)


def test_patterns_are_of_one_size():
    cloth, found = of_sheet()
    assert len(found) >= 5  # families, and bands of maps of all and of each
    for B in found:
        assert len(B) == len(cloth.springs)
        assert (B**2).sum() == pytest.approx(len(B), rel=1e-12)


def test_families_are_a_pattern():
    cloth, (member, *_) = of_sheet()
    groups = spring_groups(cloth)
    assert member.shape[1] == len(groups.names)
    assert all(np.unique(member[groups.of == i], axis=0).shape[0] == 1 for i in range(len(groups.names)))


def test_some_springs_have_the_patterns_of_all():
    own = np.arange(0, 40, 2)
    cloth, found = of_sheet(own)
    assert all(len(B) == len(own) for B in found)
    assert np.linalg.matrix_rank(found[0]) == len(np.unique(spring_groups(cloth).of[own]))


def learned(truth, found, seed=0):
    """The prior and the error of the values that it finds, and those without patterns, from noisy data that show a
    quarter of all directions well and half of them not at all.
    """
    rng, size = np.random.default_rng(seed), len(truth)
    turn = np.linalg.qr(rng.normal(size=(size, size)))[0]
    rows = 5 * size
    J = rng.normal(size=(rows, size)) / np.sqrt(rows) @ (turn * np.geomspace(1.0, 1e-4, size)) @ turn.T
    r = -J @ truth - NOISE * rng.normal(size=rows)
    results = []
    for own in (found, ()):
        prior, y = first(np.zeros(size), [np.arange(size)], None, [own] if own else ()), np.zeros(size)
        for _ in range(3):
            now = r + J @ y
            prior, sigma2 = prior.settled(J.T @ J, J.T @ now, y, float(now @ now), rows)
            A = prior.matrix(sigma2)
            y = y - np.linalg.solve(J.T @ J + A, J.T @ now + A @ y)
        results.append((prior, float(np.sqrt(np.mean((y - truth) ** 2)))))
    return results


def test_values_of_families_are_found_from_fewer_data_than_there_are_values():
    cloth, found = of_sheet()
    level = np.array([1.0, -0.5, 0.2, -1.2, 0.6, 0.1, -0.3, 0.8, 0.0])[spring_groups(cloth).of]
    (prior, with_patterns), (_, without) = learned(level, found)
    # the few levels are known as well as the noise allows; most of the single values are not shown at all
    assert with_patterns < 3 * NOISE < 0.2 < without
    assert prior.widths[0][0] < 0.01 < 0.3 < prior.widths[0][1]


def test_patterns_cost_little_where_values_follow_none():
    cloth, found = of_sheet()
    ratios = []
    for seed in range(8):
        truth = 0.5 * np.random.default_rng(seed).normal(size=len(cloth.springs))
        (_, with_patterns), (_, without) = learned(truth, found, seed)
        ratios.append(with_patterns / without)
    # in the mean over draws hardly anything; what chance alone may do in one of them is below its error of 1 / sqrt(40)
    assert np.mean(ratios) < 1.05
    assert np.max(ratios) < 1.3
