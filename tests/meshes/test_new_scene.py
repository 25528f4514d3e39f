"""Scenes made of meshes: the editor's numbers, and that they move."""

import json

import numpy as np
import pytest
from helpers.paths import EXAMPLES

import clothfit
from clothfit import InvalidInput, InvalidScene
from clothfit.meshes import mesh
from clothfit.meshes.mesh import Mesh
from clothfit.meshes.new_scene import new_scene, text
from clothfit.scene.schema import conforms, schema_path

DIGITS = 1e-11  # the examples are written with 12 digits

# Areas 1 and 3 m² at the common edge 0-1 of length 2 m; the vertices opposite it are 4 m apart.
TWO = Mesh(np.array([[-1.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, -3, 0]]), np.array([[0, 1, 2], [1, 0, 3]], np.int32))


def test_masses_and_stiffnesses_of_two_triangles():
    (cloth,) = new_scene(TWO, density=0.6, stiffness=8.0).cloths
    assert cloth.mass.tolist() == pytest.approx([0.8, 0.8, 0.2, 0.6], rel=1e-14)  # 0.6 of 4/3, 4/3, 1/3, 1 m²
    # 8 (1 + 3)/4, 8·1/2 twice, (8/4)·2·3/16 with the area of the second triangle, 8·3/10 twice
    assert cloth.stiffness.tolist() == pytest.approx([8.0, 4.0, 4.0, 0.75, 2.4, 2.4], rel=1e-14)


@pytest.mark.parametrize("share", [0.5, 0.1, 2.0])
def test_bending_has_the_share_that_is_asked_for(share):
    own, usual = (new_scene(TWO, stiffness=8.0, bending=b).cloths[0].stiffness for b in (share, True))
    np.testing.assert_allclose(own / usual, [1, 1, 1, share / 0.25, 1, 1], rtol=1e-14)


@pytest.mark.parametrize("nothing", [False, 0, 0.0])
def test_without_bending_there_are_only_edges(nothing):
    (cloth,) = new_scene(TWO, bending=nothing).cloths
    np.testing.assert_array_equal(cloth.springs, mesh.edges(TWO.triangles))


@pytest.mark.parametrize("density", [0.05, 0.2, 3.0])
def test_the_mass_of_a_cloth_is_density_times_area(density):
    sheet = mesh.plane(7, 3.0, 2.0)
    assert new_scene(sheet, density=density).cloths[0].mass.sum() == pytest.approx(density * 6.0, rel=1e-13)


def same(made, path):
    """Whether a scene is that of an example, up to the digits of the file."""
    known = clothfit.load(path)
    for name in ("delta", "tolerance", "frames", "method", "newton_iterations", "title"):
        assert getattr(made, name) == getattr(known, name)
    np.testing.assert_array_equal(made.wind, known.wind)
    balls = [[(*ball.centre, ball.radius) for ball in each.spheres] for each in (made, known)]
    assert balls[0] == balls[1]
    (a,), (b,) = made.cloths, known.cloths
    for name in ("springs", "triangles", "fixed", "drag", "damping", "settings"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
    for name in ("positions", "mass", "stiffness"):
        np.testing.assert_allclose(getattr(a, name), getattr(b, name), rtol=DIGITS, atol=DIGITS)


def test_the_examples_can_be_made():
    level, upright = mesh.plane(10, 7.0), mesh.plane(10, 7.0, upright=True)
    x, z = level.positions[:, 0], level.positions[:, 2]
    of = {"density": 0.1, "stiffness": 50.0, "integrator": "implicit", "tolerance": 1e-5}
    wind = (106.066, 0.0, -106.066)
    same(new_scene(level, z == 3.5, **of, fit="nL", title="side"), EXAMPLES / "side.json")
    corner = (abs(x) == 3.5) & (abs(z) == 3.5)
    same(new_scene(level, corner, **of, fit="Ln", title="corners"), EXAMPLES / "corners.json")
    same(new_scene(upright, x == -3.5, **of, fit="nG", wind=wind, title="flag"), EXAMPLES / "flag.json")
    ball = [(0.0, -4.1, 0.0, 4.0)]
    same(new_scene(level, **of, spheres=ball, fit="Gn", title="drape"), EXAMPLES / "drape.json")


def test_a_scene_made_is_what_its_text_says_and_obeys_the_schema():
    made = new_scene(TWO, fits={"wind": "G", "velocity": "L", "rest": "L"}, title="two")
    again = clothfit.load(json.loads(made.source.text))
    np.testing.assert_array_equal(again.cloths[0].stiffness, made.cloths[0].stiffness)
    schema = json.loads(schema_path().read_text("utf-8"))
    assert conforms(json.loads(made.source.text), schema, schema)
    assert (again.fits, again.cloths[0].fits) == ({"wind": "G"}, {"velocity": "L", "rest": "L"})
    assert text(json.loads(made.source.text)) == made.source.text


def test_it_moves_and_held_vertices_do_not():
    made = new_scene(mesh.plane(3, 1.0), [True] * 5 + [False] * 20, frames=20)
    motion = clothfit.simulate(made)
    np.testing.assert_array_equal(motion.positions[-1, :5], motion.positions[0, :5])
    assert (motion.positions[-1, 5:, 1] < 0).all()


def test_what_is_held_nowhere_falls_freely():
    h, k = 0.01, 30
    own = {"delta": h, "frames": k + 1, "damping": 0.0, "drag": 0.0, "integrator": "implicit"}
    motion = clothfit.simulate(new_scene(mesh.plane(3, 1.0), **own))
    # implicit steps fall g h² k (k + 1)/2; no spring is stretched, so only rounding differs
    np.testing.assert_allclose(motion.positions[-1, :, 1], -9.81 * h * h * k * (k + 1) / 2, rtol=1e-9)


@pytest.mark.parametrize(
    "options",
    [{"density": 0.0}, {"density": -1.0}, {"density": np.nan}, {"density": np.inf}, {"stiffness": -1.0},
     {"bending": -0.1}, {"bending": np.nan}, {"integrator": "magic"}, {"fits": {"mass": "G"}}, {"fits": {"wind": "L"}},
     {"fits": {"damping": "X"}}, {"fixed": [True]}],
)  # fmt: skip
def test_what_cannot_be_is_refused(options):
    with pytest.raises(InvalidInput):
        new_scene(TWO, **options)


@pytest.mark.parametrize(
    ("options", "place"),
    [({"delta": 0.0}, "delta"), ({"delta": np.nan}, "delta"), ({"frames": 1}, "optimizationIterations"),
     ({"tolerance": 1.0}, "tolerance"), ({"damping": -1.0}, r"objects\[0\].damping"),
     ({"drag": np.inf}, r"objects\[0\].dragCoefficient"), ({"fit": "xx"}, r"objects\[0\].optimizationSettings"),
     ({"spheres": [(0, 0, 0, -1)]}, r"colliders\[0\].scale.x"), ({"wind": (0, np.nan, 0)}, "windVel.y")],
)  # fmt: skip
def test_what_the_format_does_not_have_is_refused_by_the_check_of_scenes(options, place):
    with pytest.raises(InvalidScene, match=place):
        new_scene(TWO, **options)


def test_of_a_path_it_says_how_to_read_it():
    with pytest.raises(InvalidInput, match=r"mesh: a path is given, 'a.obj'; read it: clothfit.read_mesh\('a.obj'\)"):
        new_scene("a.obj")
