"""The places of a cloth that are nearest to points of a scan."""

import numpy as np

from clothfit.meshes.mesh import plane
from clothfit.motion.feet import UNKNOWN, Faces, nearest


def test_points_on_folded_and_stretched_cloth_find_the_nearest_triangle():
    """Layers are closer than half an edge, and triangles three times as long as wide."""
    mesh = plane(18, 1.0)
    x, triangles = mesh.positions.copy(), mesh.triangles.astype(np.int32)
    along = 3.0 * (x[:, 0] - x[:, 0].min())
    layer = np.floor(along)
    x[:, 0] = np.where(layer % 2 == 0, along - layer, layer + 1.0 - along)
    x[:, 1] = 0.02 * layer
    rng = np.random.default_rng(0)
    chosen = x[triangles[rng.integers(len(triangles), size=2000)]]
    points = np.einsum("mk,mkc->mc", rng.dirichlet([1, 1, 1], 2000), chosen)
    points += 1e-3 * rng.normal(size=points.shape)
    found = Faces.of(triangles, len(x)).feet(points, np.full(len(points), UNKNOWN), x)
    np.testing.assert_allclose(np.abs(found.gaps), nearest(points, x, triangles)[1], atol=1e-9)
