"""What a new scene says of its weave: texture, warp, regions and the parts of files, through welding."""

import numpy as np
import pytest

from clothfit.base.errors import InvalidInput
from clothfit.meshes.mesh import Mesh, plane
from clothfit.meshes.mesh_file import read_mesh
from clothfit.meshes.new_scene import along, new_scene
from clothfit.meshes.weld import weld
from clothfit.scene.families import spring_groups, vertex_groups


def textured(mesh, u, v):
    """The mesh with texture coordinates that are linear in its positions."""
    return mesh._replace(texture=np.stack([mesh.positions @ u, mesh.positions @ v], axis=-1)[mesh.triangles])


def counts(scene):
    groups = spring_groups(scene.cloths[0])
    return dict(zip(groups.names, np.bincount(groups.of).tolist(), strict=True))


@pytest.mark.parametrize("seed", range(3))
def test_the_direction_in_which_u_grows_is_that_of_the_texture(seed):
    """u = x·a, v = x·b in the plane y = 0; the direction has no change of v and a positive one of u."""
    rng = np.random.default_rng(seed)
    a, b = rng.standard_normal((2, 3)) * [1, 0, 1]
    direction = along(textured(plane(3, 1.0), a, b))
    assert (direction @ a > 0).all()
    assert direction @ b == pytest.approx(np.zeros(len(direction)), abs=1e-12)  # rounding


def test_a_texture_without_area_or_with_gaps_has_no_direction():
    mesh = textured(plane(1, 1.0), [1.0, 0, 0], [2.0, 0, 0])
    assert not along(mesh).any()
    holes = textured(plane(1, 1.0), [1.0, 0, 0], [0, 0, 1.0])
    holes.texture[0, 1] = np.nan
    assert along(holes).any(axis=1).tolist() == [False, *[True] * 7]


def test_a_texture_that_agrees_with_the_grid_is_not_written():
    assert "families" not in new_scene(textured(plane(3, 1.0, 0.5), [1.0, 0, 0], [0, 0, 1.0])).source.text


def test_a_texture_turned_by_a_right_angle_swaps_the_directions():
    plain = counts(new_scene(plane(4, 1.0, 0.6)))
    turned = counts(new_scene(textured(plane(4, 1.0, 0.6), [0, 0, 1.0], [1.0, 0, 0])))
    assert turned["edges along"] == plain["edges across"]
    assert turned["bending across"] == plain["bending along"]
    assert turned["edges diagonal"] == plain["edges diagonal"]


def test_the_warp_comes_before_the_texture():
    mesh = textured(plane(4, 1.0, 0.6), [0, 0, 1.0], [1.0, 0, 0])
    scene = new_scene(mesh, warp=(2, 0, 0))
    assert counts(scene) == counts(new_scene(plane(4, 1.0, 0.6)))
    assert scene.cloths[0].layout.warp.tolist() == [2.0, 0.0, 0.0]


def test_regions_that_are_given_come_before_the_parts_of_the_mesh():
    parts = (("hem", np.array([0, 1, 2], np.int32)), ("all", np.arange(9, dtype=np.int32)),
             ("elsewhere", np.array([5], np.int32)))
    scene = new_scene(plane(1, 1.0)._replace(parts=parts), regions={"patch": [8, 2, 8]})
    names = [(region.name, region.vertices.tolist()) for region in scene.cloths[0].layout.regions]
    assert names == [("patch", [2, 8]), ("hem", [0, 1, 2]), ("elsewhere 2", [5])]
    assert vertex_groups(scene.cloths[0]).of.tolist() == [1, 1, 0, 3, 3, 2, 3, 3, 0]


@pytest.mark.parametrize(
    ("regions", "word"),
    [({"": [1]}, "cannot be a name"), ({"elsewhere": [1]}, "cannot be a name"), ({"a": []}, "has no vertices"),
     ({"a": [9]}, "no vertex 9; there are 9"), ({"a": [-1, 2]}, "no vertex -1")],
)  # fmt: skip
def test_wrong_regions_are_refused(regions, word):
    with pytest.raises(InvalidInput, match=word):
        new_scene(plane(1, 1.0), regions=regions)


@pytest.mark.parametrize("warp", [(0, 0, 0), (1, 2), (np.nan, 0, 1)])
def test_a_warp_without_a_direction_is_refused(warp):
    with pytest.raises(InvalidInput, match=r"warp: .* is not a direction"):
        new_scene(plane(1, 1.0), warp=warp)


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
