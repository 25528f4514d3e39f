"""Values between keys: closed forms."""

import numpy as np

from clothfit.formats.gltf_scene import Track

HALF = np.sqrt(0.5)


# A cubic is given by its values and slopes at both ends.
def test_a_spline_is_the_cubic_with_its_values_and_tangents():
    times = np.array([0.0, 2.0, 3.0])
    value, slope = times**3 - times, 3 * times**2 - 1
    track = Track(times, np.stack([slope, value, slope], axis=1)[..., None], "CUBICSPLINE")
    t = np.linspace(0, 3, 13)
    np.testing.assert_allclose(track.at(t)[:, 0], t**3 - t, atol=1e-14)  # values up to 24, a few roundings


def test_rotations_turn_evenly_and_the_shorter_way():
    ends = np.array([[0, 0, 0, 1], [0, 0, -HALF, -HALF]])  # a quarter about z, with the other sign
    angles = np.linspace(0, np.pi / 2, 5)
    turned = Track(np.array([0.0, 1.0]), ends, "LINEAR").at(np.linspace(0, 1, 5), rotation=True)
    turned *= np.sign(turned[:, 3:])  # of either sign it is the same rotation
    np.testing.assert_allclose(turned[:, 2], np.sin(angles / 2), atol=1e-15)
    np.testing.assert_allclose(turned[:, 3], np.cos(angles / 2), atol=1e-15)


def test_values_stay_before_the_first_key_and_after_the_last():
    track = Track(np.array([1.0, 2.0]), np.array([[3.0], [5.0]]), "LINEAR")
    np.testing.assert_array_equal(track.at(np.array([0, 1, 1.5, 2, 9]))[:, 0], [3, 3, 4, 5, 5])
