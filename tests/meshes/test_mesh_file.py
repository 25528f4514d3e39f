"""Meshes from files: axes, units, which way faces look, and what is no mesh."""

import numpy as np
import pytest
import trimesh

import clothfit
from clothfit import InvalidInput
from clothfit.meshes import mesh
from clothfit.meshes.mesh import read_mesh, turned

CORNERS = np.array([[1.0, 2, 3], [2, 2, 3], [1, 4, 3], [1, 2, 7]])


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def obj(points, faces=((1, 2, 3), (1, 4, 2))):
    rows = [f"v {x} {y} {z}" for x, y, z in points] + ["f " + " ".join(map(str, face)) for face in faces]
    return "\n".join(rows)


def test_right_handed_files_are_mirrored_as_unity_does_and_keep_their_front(folder):
    (folder / "a.obj").write_text(obj(CORNERS))
    found, notes = read_mesh("a.obj")
    np.testing.assert_array_equal(found.positions, CORNERS * [-1, 1, 1])
    assert sorted(found.triangles[0]) == [0, 1, 2]
    assert notes[0] == "read as y up, right-handed, metres"
    # In a right-handed file a face looks along (b - a) x (c - a); in left-handed axes along the opposite of the mirror.
    a, b, c = CORNERS[[0, 1, 2]]
    outside = np.cross(b - a, c - a) * [-1, 1, 1]
    a, b, c = found.positions[found.triangles[0]]
    assert np.cross(b - a, c - a) @ outside > 0


def test_what_the_user_knows_better(folder):
    (folder / "a.obj").write_text(obj(CORNERS))
    found, notes = read_mesh("a.obj", up="z", handedness="left", scale=0.01)
    np.testing.assert_allclose(found.positions, 0.01 * CORNERS[:, [0, 2, 1]] * [1, 1, -1], rtol=1e-15)
    assert notes[0] == "read as z up, left-handed, units of 0.01 m"


def test_the_vertices_keep_the_files_order_in_every_format(folder):
    solid = trimesh.creation.icosphere(1)
    kept = []
    for name in ("s.ply", "s.obj", "s.glb"):
        solid.export(folder / name)
        kept.append(read_mesh(name))
    for found, _ in kept:
        # .glb holds single precision, trimesh's .obj eight digits
        np.testing.assert_allclose(found.positions, solid.vertices * [-1, 1, 1], atol=1e-7)
        np.testing.assert_array_equal(np.sort(found.triangles), np.sort(solid.faces))
        assert mesh.areas(found).sum() == pytest.approx(solid.area, rel=1e-6)


@pytest.mark.parametrize("name", ["m.usda", "m.glb"])
def test_of_an_animated_file_the_first_frame_is_taken(folder, name):
    scene = clothfit.new_scene(mesh.plane(2, 1.0), frames=4)
    clothfit.save_motion(clothfit.simulate(scene), name, scene)
    found, _ = read_mesh(name)
    np.testing.assert_allclose(found.positions, scene.cloths[0].positions, atol=2e-5)  # .glb: to 1e-5 m
    np.testing.assert_array_equal(np.sort(found.triangles), np.sort(scene.cloths[0].triangles))


def test_of_a_sequence_the_first_file_alone_is_read(folder):
    (folder / "s_9.obj").write_text(obj(CORNERS))
    (folder / "s_10.obj").write_text("not read")
    np.testing.assert_array_equal(read_mesh("s_*.obj")[0].positions, CORNERS * [-1, 1, 1])


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [("a.npz", "o", "no mesh format has that suffix; known are .obj"), ("a", "o", "has that suffix"),
     ("a.npz", "", "it is empty; export it again"),
     ("a.csv", "", "CSV markers hold no faces; a mesh is needed, in .obj"), ("a.obj", "v 0 0 0\n", "has no faces"),
     ("a.ply", "", "it is empty"), ("a.ply", "a", "has no header"),
     ("a.obj", obj([(0, 0, 0), ("inf", 0, 0), (0, 1, 0)], [(1, 2, 3)]), "")],
)  # fmt: skip
def test_what_is_no_mesh_is_refused(folder, name, text, message):
    (folder / name).write_text(text)
    with pytest.raises(InvalidInput, match=f"^{name}.*: .*{message}"):
        read_mesh(name)


@pytest.mark.parametrize("scale", [0.0, -1.0, np.nan, np.inf])
def test_a_scale_that_cannot_be_is_refused(folder, scale):
    (folder / "a.obj").write_text(obj(CORNERS))
    with pytest.raises(InvalidInput, match=r"^scale must be above 0"):
        read_mesh("a.obj", scale=scale)


AXES = np.eye(3)


@pytest.mark.parametrize(
    ("degrees", "expected"),
    # Unity's axes are left-handed: a quarter turn about y takes z to x, about x takes y to z, about z takes x to y.
    [((0, 90, 0), [[0, 0, -1], [0, 1, 0], [1, 0, 0]]), ((90, 0, 0), [[1, 0, 0], [0, 0, 1], [0, -1, 0]]),
     ((0, 0, 90), [[0, 1, 0], [-1, 0, 0], [0, 0, 1]]),
     ((90, 90, 0), [[0, 0, -1], [1, 0, 0], [0, -1, 0]])],  # about x first: y to z, then with z to x
)  # fmt: skip
def test_turns_are_unitys(degrees, expected):
    np.testing.assert_allclose(turned(AXES, degrees), expected, atol=1e-15)  # of sines and cosines
    turn = turned(AXES, np.add(degrees, (20, -50, 130))).T
    np.testing.assert_allclose(turn @ turn.T, AXES, atol=1e-15)
    assert np.linalg.det(turn) == pytest.approx(1.0, rel=1e-14)
