"""The nearest point of a triangle: the conditions of a projection, and its derivative against differences."""

import numpy as np
import pytest

from clothfit.engine.forces import triangle
from clothfit.kernels.kernel import kernel
from clothfit.kernels.lanes.operations import load3, store3

PARTS = 7


@kernel
def found(points, corners, part, weights, gradients):
    """The part (n,), weights (n, 3) and gradients (n, 2, 3) for points (n, 3) and triangles (n, 3, 3)."""
    for i in range(len(points)):
        a, b, c = load3(corners[i], 0), load3(corners[i], 1), load3(corners[i], 2)
        part[i], wb, wc = triangle.nearest(load3(points, i), a, b, c)
        weights[i, 0], weights[i, 1], weights[i, 2] = 1.0 - wb - wc, wb, wc
        by_b, by_c = triangle.weight_gradients(part[i], a, b, c)
        store3(by_b, gradients[i], 0)
        store3(by_c, gradients[i], 1)


def nearest(points, corners):
    n = len(points)
    part, weights, gradients = np.zeros(n, np.int64), np.zeros((n, 3)), np.zeros((n, 2, 3))
    found(points, corners, part, weights, gradients)
    return part, weights, gradients


def samples(seed, thin):
    rng = np.random.default_rng(seed)
    corners = rng.normal(size=(4000, 3, 3))
    corners[:, 2] += (corners[:, 0] - corners[:, 2]) * thin
    return rng.normal(scale=1.5, size=(4000, 3)), corners


@pytest.mark.parametrize("thin", [0.0, 0.999])
def test_the_nearest_point_is_the_projection(thin):
    points, corners = samples(1, thin)
    part, weights, _ = nearest(points, corners)
    assert (np.bincount(part, minlength=PARTS) > 0).all()
    assert (weights > -1e-15).all()  # 1 − w_b − w_c is rounded
    q = np.einsum("ni,nij->nj", weights, corners)
    # of a convex set: no corner is on the point's side of the plane through q across p − q
    reach = np.einsum("nj,nij->ni", points - q, corners - q[:, None])
    assert reach.max() < 1e-11 / (1 - thin)


def test_weights_turn_with_the_point_as_their_gradients_say():
    points, corners = samples(2, 0.0)
    part, _, gradients = nearest(points, corners)
    t = 1e-6
    for axis in range(3):
        step = t * np.eye(3)[axis]
        above, below = nearest(points + step, corners), nearest(points - step, corners)
        same = (above[0] == part) & (below[0] == part)
        assert same.mean() > 0.99
        slope = (above[1] - below[1])[same, 1:] / (2 * t)
        # linear in the point: rounding of weights at 1e-6, larger where a triangle is thin
        scale = 1 + np.abs(gradients[same]).max(axis=(1, 2))[:, None]
        assert np.abs((slope - gradients[same, :, axis]) / scale).max() < 1e-7


def test_a_weighted_mean_moves_with_its_weights():
    points, corners = samples(3, 0.0)
    vectors, out = np.random.default_rng(4).normal(size=(3, 3)), np.zeros((2, 3))

    @kernel
    def change(corner, dp, vectors, out):
        a, b, c = load3(corner, 0), load3(corner, 1), load3(corner, 2)
        by_b, by_c = triangle.weight_gradients(triangle.FACE, a, b, c)
        va, vb, vc = load3(vectors, 0), load3(vectors, 1), load3(vectors, 2)
        store3(triangle.moved(by_b, by_c, load3(dp, 0), va, vb, vc), out, 0)
        store3(triangle.weighted(0.2, 0.3, va, vb, vc), out, 1)

    change(corners[0], points[:1], vectors, out)
    gradients = np.linalg.pinv((corners[0, 1:] - corners[0, 0]).T)  # of w_b and w_c of a point in the plane
    rates = gradients @ points[0]
    expected = rates @ (vectors[1:] - vectors[0])
    np.testing.assert_allclose(out[0], expected, rtol=1e-10)
    np.testing.assert_allclose(out[1], [0.5, 0.2, 0.3] @ vectors, rtol=1e-14)
