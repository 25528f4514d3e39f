"""Targets whose points are the scene's vertices in another order, or lie in or over its triangles."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from helpers.fits import estimate
from helpers.strangers import sheet

from clothfit import InvalidMotion, cost_and_gradient, simulate, with_parameters
from clothfit.formats.axes import Reading
from clothfit.motion.correspondence import TooFar, embedded, normals
from clothfit.motion.foreign import load
from clothfit.registration.record import rotation

SCENE = sheet(letters="nF", frames=24)
(CLOTH,) = SCENE.cloths
TRIANGLES = CLOTH.triangles.reshape(-1, 3)
RNG = np.random.default_rng(0)
CHOSEN, WEIGHTS = RNG.integers(len(TRIANGLES), size=200), RNG.dirichlet([1, 1, 1], 200)
ORDER = RNG.permutation(36)


@cache
def recorded():
    return simulate(with_parameters(SCENE, np.array([2.0])), tolerance=1e-12)


def points(off=0.0):
    """Points of the motion inside triangles, so far from them, m."""
    corners = TRIANGLES[CHOSEN]
    on = np.einsum("pk,fpkc->fpc", WEIGHTS, recorded().positions[:, corners])
    return on + off * np.stack([normals(x, corners) for x in recorded().positions])


@pytest.fixture
def seen(tmp_path):
    """What a file with some points shows of the scene."""

    def read(positions, bind=None):
        np.savez(tmp_path / "a.npz", positions=positions, times=recorded().times)
        return load(tmp_path / "a.npz", SCENE, Reading(bind=bind)).motion

    return read


@pytest.mark.slow
@pytest.mark.parametrize(
    ("shown", "kind", "within"),
    [
        (lambda: recorded().positions, "same", 1e-9),
        (lambda: recorded().positions[:, ORDER], "permuted", 1e-9),
        (points, "surface", 1e-6),
        (lambda: points(1e-3), "surface", 1e-2),
    ],
)
def test_a_fit_to_points_has_the_values_of_one_to_vertices(seen, shown, kind, within):
    fit = estimate(SCENE, seen(shown()), intervals=False)
    assert (fit.correspondence.kind, fit.correspondence.share) == (kind, 1.0)
    assert fit.scene.cloths[0].stiffness == pytest.approx(2.0 * CLOTH.stiffness, rel=within)


def test_the_gradient_of_a_cost_of_points_is_its_derivative(seen):
    target, step = seen(points(1e-3)), 1e-5
    _, gradient = cost_and_gradient(SCENE, target)
    costs = [cost_and_gradient(with_parameters(SCENE, np.array([1.0 + s])), target)[0] for s in (step, -step)]
    assert gradient[0] == pytest.approx((costs[0] - costs[1]) / (2 * step), rel=1e-6)  # errors of the order step²


def test_points_that_are_far_from_the_mesh_are_refused_with_figures(seen):
    with pytest.raises(InvalidMotion, match=r"36 vertices; 100 % of the points lie more than half an edge"):
        seen(points() + [0.0, 3.0, 0.0])


def test_a_mesh_that_is_bound_moves_as_its_triangles_do():
    """Turned and moved as a whole, it goes along; its own vertices are where they are."""
    turns = [rotation(np.array([0.3 * k, -0.2 * k, 0.5 * k])) for k in range(4)]
    x = np.stack([CLOTH.positions @ R.T + [k, 0.0, -k] for k, R in enumerate(turns)])
    others = points(2e-3)[0]
    found = embedded(x, SCENE, others, "render.obj")
    wanted = np.stack([others @ R.T + [k, 0.0, -k] for k, R in enumerate(turns)])
    np.testing.assert_allclose(found, wanted, atol=1e-12)  # rounding
    x = recorded().positions
    np.testing.assert_allclose(embedded(x, SCENE, CLOTH.positions, "a"), x, atol=1e-12)
    with pytest.raises(TooFar):
        embedded(x, replace(SCENE, name="a.json"), others + 1.0, "render.obj")
