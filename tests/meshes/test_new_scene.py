"""Scenes made of meshes: the editor's numbers, and that they move."""

import json
from functools import partial

import numpy as np
import pytest
from helpers.paths import EXAMPLES

from clothfit import InvalidInput, InvalidScene, load, mesh, simulate
from clothfit.meshes.mesh import Mesh, plane, read_mesh
from clothfit.meshes.new_scene import along, at_side, in_box, listed, new_scene, text
from clothfit.meshes.problems import weld
from clothfit.scene.families import spring_groups, vertex_groups
from clothfit.scene.schema import problems_of

DIGITS = 1e-11  # the examples are written with 12 digits

# Areas 1 and 3 m² at the common edge 0-1 of length 2 m; the vertices opposite it are 4 m apart.
TWO = Mesh(np.array([[-1.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, -3, 0]]), np.array([[0, 1, 2], [1, 0, 3]], np.int32))


def same(made, path):
    """Whether a scene is that of an example, up to the digits of the file."""
    known = load(path)
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
    again = load(json.loads(made.source.text))
    np.testing.assert_array_equal(again.cloths[0].stiffness, made.cloths[0].stiffness)
    assert problems_of(json.loads(made.source.text)) == []
    assert (again.fits, again.cloths[0].fits) == ({"wind": "G"}, {"velocity": "L", "rest": "L"})
    assert text(json.loads(made.source.text)) == made.source.text


def test_what_is_held_nowhere_falls_freely():
    h, k = 0.01, 30
    own = {"delta": h, "frames": k + 1, "damping": 0.0, "drag": 0.0, "integrator": "implicit"}
    sheet = mesh.plane(3, 1.0)
    held = simulate(new_scene(sheet, [True] * 5 + [False] * 20, **own)).positions
    np.testing.assert_array_equal(held[-1, :5], held[0, :5])
    motion = simulate(new_scene(sheet, **own))
    # implicit steps fall g h² k (k + 1)/2; no spring is stretched, so only rounding differs
    np.testing.assert_allclose(motion.positions[-1, :, 1], -9.81 * h * h * k * (k + 1) / 2, rtol=1e-9)


@pytest.mark.parametrize(
    ("options", "place"),
    [({"delta": 0.0}, "delta"), ({"delta": np.nan}, "delta"), ({"frames": 1}, "optimizationIterations"),
     ({"tolerance": 1.0}, "tolerance"), ({"damping": -1.0}, r"objects\[0\].damping"),
     ({"drag": np.inf}, r"objects\[0\].dragCoefficient"), ({"fit": "xx"}, r"objects\[0\].optimizationSettings"),
     ({"drag_law": "x"}, r"objects\[0\].dragLaw"),
     ({"spheres": [(0, 0, 0, -1)]}, r"colliders\[0\].scale.x"), ({"wind": (0, np.nan, 0)}, "windVel.y")],
)  # fmt: skip
def test_what_the_format_does_not_have_is_refused_by_the_check_of_scenes(options, place):
    with pytest.raises(InvalidScene, match=place):
        new_scene(TWO, **options)


# Which vertices of a new cloth are held.


SHEET = mesh.plane(2, 3.0).positions  # 4 x 4 vertices, 1 m apart, from -1.5 to 1.5 in x and z


UPRIGHT = mesh.plane(2, 3.0, upright=True).positions
LEFT = [0, 4, 8, 12]


@pytest.mark.parametrize(
    ("flags", "expected"),
    [
        (in_box(SHEET, (-1.5, -1, -1.5), (-0.5, 1, 0)), [0, 1, 4, 5]),  # its surface included
        (in_box(SHEET, (-0.5, -1, 0), (-1.5, 1, -1.5)), [0, 1, 4, 5]),  # corners in any order
        (in_box(SHEET, (-1.4, -1, -1.5), (-0.6, 1, 0)), []),
        (in_box(SHEET, (-1.5, 0, -1.5), (-1.5, 0, -1.5)), [0]),
        (at_side(SHEET, "left"), LEFT),
        (at_side(SHEET, "right"), [3, 7, 11, 15]),
        (at_side(SHEET, "back"), [0, 1, 2, 3]),
        (at_side(SHEET, "front"), [12, 13, 14, 15]),
        (at_side(UPRIGHT, "top"), [12, 13, 14, 15]),
        (at_side(UPRIGHT, "bottom"), [0, 1, 2, 3]),
        (at_side(SHEET, "left", 0.99), LEFT),
        (at_side(SHEET, "left", 1.0), [0, 1, 4, 5, 8, 9, 12, 13]),  # a reach takes more rows
        (at_side(SHEET, "left", 9.0), list(range(16))),
        (listed(16, [(0, 0), (11, 11), (3, 5), (4, 6)]), [0, 3, 4, 5, 6, 11]),  # both ends included
        (listed(16, []), []),
    ],
)
def test_vertices_are_chosen_by_a_box_a_side_or_numbers(flags, expected):
    assert np.flatnonzero(flags).tolist() == expected


@pytest.mark.parametrize(
    ("choose", "message"),
    [
        (partial(new_scene, "a.obj"), r"mesh: a path is given, 'a.obj'; read it: clothfit.read_mesh\('a.obj'\)"),
        *[(partial(at_side, SHEET, *asked), "^fix side: ") for asked in
          (("inside", None), ("top", None), ("left", -1.0), ("left", np.nan))],
        *[(partial(listed, 16, [ends]), "the mesh has vertices 0 to 15") for ends in
          ((16, 16), (3, 2), (0, 99), (-1, 2))],
        *[(partial(new_scene, TWO, warp=warp), "warp: .* is not a direction") for warp in
          ((0, 0, 0), (1, 2), (np.nan, 0, 1))],
        *[(partial(new_scene, TWO, regions=regions), message) for regions, message in
          (({"": [1]}, "cannot be a name"), ({"elsewhere": [1]}, "cannot be a name"), ({"a": []}, "has no vertices"),
           ({"a": [9]}, "no vertex 9; there are 4"), ({"a": [-1, 2]}, "no vertex -1"))],
        *[(partial(new_scene, TWO, **options), message) for options, message in
          (({"density": 0.0}, "density must be above 0"), ({"density": -1.0}, "density"), ({"density": np.inf}, "dens"),
           ({"density": np.nan}, "density"), ({"stiffness": -1.0}, "stiffness must be at least 0"),
           ({"bending": -0.1}, "bending"), ({"bending": np.nan}, "bending"), ({"integrator": "magic"}, "no 'magic'"),
           ({"fits": {"mass": "G"}}, "no 'mass'"), ({"fits": {"wind": "L"}}, "wind cannot be fitted as 'L'"),
           ({"fits": {"damping": "X"}}, "damping cannot"), ({"fixed": [True]}, "1 values for 4 vertices"))],
    ],
)  # fmt: skip
def test_what_cannot_be_is_refused(choose, message):
    with pytest.raises(InvalidInput, match=message):
        choose()


# What a new scene says of its weave: texture, warp, regions and the parts of files, through welding.


def textured(mesh, u, v):
    """The mesh with texture coordinates that are linear in its positions."""
    return mesh._replace(texture=np.stack([mesh.positions @ u, mesh.positions @ v], axis=-1)[mesh.triangles])


def counts(scene):
    groups = spring_groups(scene.cloths[0])
    return dict(zip(groups.names, np.bincount(groups.of).tolist(), strict=True))


def test_the_direction_in_which_u_grows_is_that_of_the_texture():
    """u = x·a, v = x·b in the plane y = 0; the direction has no change of v and a positive one of u."""
    for a, b in np.random.default_rng(0).standard_normal((3, 2, 3)) * [1, 0, 1]:
        direction = along(textured(plane(3, 1.0), a, b))
        assert (direction @ a > 0).all()
        assert direction @ b == pytest.approx(np.zeros(len(direction)), abs=1e-12)  # rounding
    assert not along(textured(plane(1, 1.0), [1.0, 0, 0], [2.0, 0, 0])).any()  # without area
    holes = textured(plane(1, 1.0), [1.0, 0, 0], [0, 0, 1.0])
    holes.texture[0, 1] = np.nan
    assert along(holes).any(axis=1).tolist() == [False, *[True] * 7]


def test_a_texture_turned_by_a_right_angle_swaps_the_directions_and_the_warp_comes_before_it():
    assert "families" not in new_scene(textured(plane(4, 1.0, 0.6), [1.0, 0, 0], [0, 0, 1.0])).source.text
    plain, mesh = counts(new_scene(plane(4, 1.0, 0.6))), textured(plane(4, 1.0, 0.6), [0, 0, 1.0], [1.0, 0, 0])
    turned = counts(new_scene(mesh))
    assert turned["edges along"] == plain["edges across"]
    assert turned["bending across"] == plain["bending along"]
    assert turned["edges diagonal"] == plain["edges diagonal"]
    scene = new_scene(mesh, warp=(2, 0, 0))
    assert counts(scene) == plain
    assert scene.cloths[0].layout.warp.tolist() == [2.0, 0.0, 0.0]


def test_regions_that_are_given_come_before_the_parts_of_the_mesh():
    parts = (("hem", np.array([0, 1, 2], np.int32)), ("all", np.arange(9, dtype=np.int32)),
             ("elsewhere", np.array([5], np.int32)))
    scene = new_scene(plane(1, 1.0)._replace(parts=parts), regions={"patch": [8, 2, 8]})
    names = [(region.name, region.vertices.tolist()) for region in scene.cloths[0].layout.regions]
    assert names == [("patch", [2, 8]), ("hem", [0, 1, 2]), ("elsewhere 2", [5])]
    assert vertex_groups(scene.cloths[0]).of.tolist() == [1, 1, 0, 3, 3, 2, 3, 3, 0]


def test_welding_carries_texture_and_parts():
    """Each triangle with vertices of its own and one that collapses: welded, the mesh is the first one again."""
    whole = textured(plane(4, 1.0, 0.6), [0, 0, 1.0], [1.0, 0, 0])
    corners = np.concatenate([[[0, 0, 1]], whole.triangles]).astype(np.int32)
    texture = np.concatenate([np.full((1, 3, 2), 7.0), whole.texture])
    loose = Mesh(
        whole.positions[corners].reshape(-1, 3), np.arange(corners.size, dtype=np.int32).reshape(-1, 3), texture,
        (("first", np.arange(3, 9, dtype=np.int32)), ("lost", np.zeros(0, np.int32))),
    )  # fmt: skip
    again = weld(loose).mesh
    assert again.texture == pytest.approx(whole.texture)
    ((name, own),) = again.parts
    cell = whole.positions[np.unique(whole.triangles[:2])]
    assert name == "first"
    assert sorted(again.positions[own].tolist()) == sorted(cell.tolist())
    assert counts(new_scene(again._replace(parts=()))) == counts(new_scene(whole))


def test_an_obj_file_has_texture_groups_and_materials(tmp_path, monkeypatch):
    """As Blender writes it: two quads, the first in a group, each of a material, texture corners of their own."""
    monkeypatch.chdir(tmp_path)
    text = """# Blender
mtllib flag.mtl
o Flag
v 0 0 0
v 1 0 0
v 2 0 0
v 0 1 0
v 1 1 0
v 2 1 0
vt 0.0 0.0
vt 0.0 0.5
vt 0.0 1.0
vt 1.0 0.0
vt 1.0 0.5
vt 1.0 1.0
vn 0 0 1
s off
g collar
usemtl cotton
f 1/1/1 2/2/1 5/5/1 4/4/1
g (null)
usemtl silk
f -5/-5/1 -4/-4/1 -1/-1/1 -2/-2/1
"""
    (tmp_path / "flag.obj").write_text(text)
    found, _ = read_mesh("flag.obj")
    assert [(name, own.tolist()) for name, own in found.parts] == [
        ("collar", [0, 1, 3, 4]), ("cotton", [0, 1, 3, 4]), ("silk", [1, 2, 4, 5]),
    ]  # fmt: skip
    u, v = found.texture[..., 0], found.texture[..., 1]
    at = found.positions[found.triangles]
    assert u == pytest.approx(at[..., 1])  # u grows upward in this file
    assert v == pytest.approx(-at[..., 0] / 2)  # and v to the file's right, which the scene mirrors
    assert along(found) == pytest.approx(np.outer(np.ones(4), [0, 0.5, 0]), abs=1e-12)


@pytest.mark.parametrize(
    "lines",
    ["vt x y\nf 1/1 2/1 3/1", "vt 0 0\nf 1/2 2/2 3/2", "f 1/ 2/ 3/", "vt\nf 1/1 2/1 3/1", "f 1/9999999999999 2/0 3/x",
     "g\nusemtl\no\nf 1 2 3", "g a b c\nf 1 2 3", "vt nan 0\nf 1/1 2/1 3/1", "usemtl a\nf 1 2 3 # b"],
)  # fmt: skip
def test_strange_labels_of_an_obj_file_are_left_out(tmp_path, lines):
    path = tmp_path / "a.obj"
    path.write_text("v 0 0 0\nv 1 0 0\nv 0 0 1\n" + lines + "\n")
    found, _ = read_mesh(path)
    assert (len(found.triangles), found.parts) == (1, ())
    assert not along(found).any()
