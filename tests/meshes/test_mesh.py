"""The builder of meshes and objects, against the editor's own export and closed forms; meshes from files: axes, units,
which way faces look, and what is no mesh.
"""

import json
from functools import partial

import numpy as np
import pytest
from helpers.paths import SIDE
from helpers.scenes import document

from clothfit import InvalidInput, load, mesh, new_scene, save_motion, simulate
from clothfit.meshes.mesh import Mesh, read_mesh, turned

FLOAT32 = 2e-6  # the editor computes in float32: a few roundings of 6e-8, times areas and squared lengths


def triangles(*corners):
    return np.array(corners, np.int32).reshape(-1, 3)


def strip(count, seed=1):
    """A strip of `count` triangles with random corners."""
    rng = np.random.default_rng(seed)
    return Mesh(rng.normal(size=(count + 2, 3)), triangles(*((i, i + 1, i + 2) for i in range(count))))


@pytest.mark.skipif(not SIDE.is_file(), reason="the real export ../shared/scenes/side.txt is not here")
def test_an_object_is_the_front_ends():
    """To the last index, and to single precision; the fields in its order."""
    theirs = json.loads(SIDE.read_text("utf-8-sig"))["objects"][0]
    square = mesh.plane(10, 7.0)
    of = {"density": 0.1, "stiffness": 50.0, "damping": 0.1, "drag": 0.1, "settings": theirs["optimizationSettings"]}
    ours = mesh.object_document(square, square.positions[:, 2] == 3.5, **of)
    assert list(ours) == list(theirs)
    for field in ("springs", "triangles", "vertIsFixed", "optimizationSettings"):
        assert ours[field] == theirs[field]
    for field in ("vertMass", "springStiffness", "dragCoefficient", "damping"):
        assert ours[field] == pytest.approx(theirs[field], rel=FLOAT32, abs=0)
    both = [[[v["x"], v["y"], v["z"]] for v in item["vertPos"]] for item in (ours, theirs)]
    np.testing.assert_allclose(*both, rtol=0, atol=7.0 * FLOAT32)


def test_a_plane_has_two_vertices_more_than_divisions_along_its_longer_side():
    square, wide = mesh.plane(10, 7.0), mesh.plane(10, 7.0, 3.5)
    assert square.positions.shape == (144, 3)
    assert len(square.triangles) == 2 * 11 * 11
    assert len(np.unique(wide.positions[:, 0])) == 12
    assert len(np.unique(wide.positions[:, 2])) == 7  # 5.5 cells of the same size, rounded to even
    least = mesh.plane(0, 2.0)
    assert least.triangles.tolist() == [[0, 2, 3], [0, 3, 1]]
    assert least.positions.tolist() == [[-1, 0, -1], [1, 0, -1], [-1, 0, 1], [1, 0, 1]]


@pytest.mark.parametrize("size", [(7.0, 3.0), (3.0, 7.0), (7.0, 0.1)])
def test_vertices_are_numbered_along_x_first_and_cells_have_their_four_corners(size):
    sheet = mesh.plane(6, *size)
    columns = len(np.unique(sheet.positions[:, 0]))
    x, z = sheet.positions.reshape(-1, columns, 3)[..., [0, 2]].transpose(2, 0, 1)
    assert (np.diff(x, axis=1) > 0).all()
    assert (np.diff(x, axis=0) == 0).all()
    assert (np.diff(z, axis=0) > 0).all()
    assert np.ptp(x) == pytest.approx(size[0])
    assert np.ptp(z) == pytest.approx(size[1])
    a, b, c, d = sheet.triangles[0].tolist() + sheet.triangles[1].tolist()[2:]
    assert (a, b, c, d) == (0, columns, columns + 1, 1)
    assert sorted({int(v) for v in sheet.triangles.flat}) == list(range(len(sheet.positions)))


def test_the_masses_of_any_mesh_add_up_to_density_times_area():
    sheet = strip(20)
    assert mesh.masses(sheet, 0.3).sum() == pytest.approx(0.3 * mesh.areas(sheet).sum(), rel=1e-14)
    assert mesh.areas(mesh.plane(5, 3.0, 2.0)).sum() == pytest.approx(6.0, rel=1e-14)
    one = Mesh(np.array([[0.0, 0, 0], [3, 0, 0], [0, 4, 0]]), triangles((0, 1, 2)))
    assert mesh.masses(one, 0.5).tolist() == pytest.approx([1.0, 1.0, 1.0], rel=1e-15)


def test_edges_are_listed_once_in_the_order_of_meeting_with_the_smaller_end_first():
    assert mesh.edges(triangles((5, 2, 7), (7, 2, 1))).tolist() == [[2, 5], [5, 7], [2, 7], [1, 7], [1, 2]]


def test_the_stiffnesses_of_two_unequal_triangles():
    # Areas 1 and 3 m² at the common edge 0-1 of length 2 m; the vertices opposite it are 4 m apart.
    two = Mesh(np.array([[-1.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, -3, 0]]), triangles((0, 1, 2), (1, 0, 3)))
    made = mesh.springs(two, 8.0)
    assert made.ends.tolist() == [[0, 1], [0, 2], [1, 2], [2, 3], [1, 3], [0, 3]]
    assert made.bends.tolist() == [False, False, False, True, False, False]
    # 8 (1 + 3)/4, 8·1/2 twice, (8/4)·2·3/16 with the area of the second triangle, 8·3/10 twice
    assert made.stiffness.tolist() == pytest.approx([8.0, 4.0, 4.0, 0.75, 2.4, 2.4], rel=1e-14)


def test_without_bending_only_edges_get_springs():
    sheet = mesh.plane(3, 1.0)
    made, every = mesh.springs(sheet, 50.0, bending=False), mesh.springs(sheet, 50.0)
    assert len(every.ends) == 3 * len(sheet.triangles)
    np.testing.assert_array_equal(made.ends, mesh.edges(sheet.triangles))
    np.testing.assert_array_equal(made.ends, every.ends[~every.bends])
    np.testing.assert_array_equal(made.stiffness, every.stiffness[~every.bends])
    half = mesh.springs(sheet, 50.0, bending=0.5)  # twice the editor's share
    np.testing.assert_allclose(half.stiffness / every.stiffness, np.where(every.bends, 2.0, 1.0), rtol=1e-14)
    nothing = mesh.springs(Mesh(np.zeros((0, 3)), triangles()), 1.0)
    assert (nothing.ends.shape, nothing.stiffness.shape) == ((0, 2), (0,))


def test_springs_do_not_depend_on_place_turn_or_scale():
    sheet = strip(30)
    turn, _ = np.linalg.qr(np.random.default_rng(2).normal(size=(3, 3)))
    moved = sheet._replace(positions=3.0 * sheet.positions @ turn + [4.0, -5.0, 6.0])
    # Area and squared length scale alike; 1e-9 covers the thinnest of the random triangles.
    np.testing.assert_allclose(mesh.springs(moved, 1.0).stiffness, mesh.springs(sheet, 1.0).stiffness, rtol=1e-9)


def test_air_pushes_a_face_as_in_the_world():
    # ½ · 1.2 kg/m³ · 2 m² · (5 m/s)² = 30 N, all corners together: drag · A · (2 A)² · v
    one = Mesh(np.array([[0.0, 0, 0], [2, 0, 0], [0, 2, 0]]), triangles((0, 1, 2)))
    made = mesh.object_document(one, [False] * 3, density=1.0, stiffness=1.0, drag=mesh.air_drag(one, 5.0))
    scene = load(document(made, windVel={"x": 0.0, "y": 0.0, "z": 5.0}, integrationMethod=0, delta=0.5))
    moved = simulate(scene, 3).positions[2, :, 2]  # the second step moves by h · h f/m, h = 0.5 s
    np.testing.assert_allclose(moved, 0.25 * 30.0 / 2.0, rtol=1e-12)  # of 2 kg


SHEET = mesh.plane(1, 1.0)
FOLDED = Mesh(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 1, 0]]), triangles((0, 1, 2), (1, 0, 3)))
ALONE = SHEET._replace(positions=np.vstack([SHEET.positions, [9.0, 9.0, 9.0]]))
SIZES = [(-1, 1.0), (4, 0.0), (4, 1.0, -1.0), (4, float("nan")), (10, 1e308, 1e308), (10, 1e200), (10, np.inf)]


@pytest.mark.parametrize(
    ("make", "message"),
    [
        *[(partial(mesh.plane, *size), "nothing can be made of that") for size in SIZES],
        (partial(mesh.sides, triangles((0, 1, 2), (1, 0, 3), (0, 1, 4))),
         "3 triangles share the edge between vertices 0 and 1; at most 2 can"),
        (partial(mesh.springs, FOLDED, 1.0), "vertices 2 and 3 need a spring but are at the same place"),
        (partial(mesh.masses, ALONE, 0.1), "vertex 9 has no mass"),
        (partial(mesh.object_document, SHEET, [True] * 8, density=0.1, stiffness=50.0), "8 values for 9 vertices"),
    ],
)  # fmt: skip
def test_what_is_no_cloth_is_refused(make, message):
    with pytest.raises(InvalidInput, match=message):
        make()


# Meshes from files.


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
    for scale in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(InvalidInput, match=r"^scale must be above 0"):
            read_mesh("a.obj", scale=scale)


def test_of_an_animated_file_the_first_frame_is_taken(folder):
    scene = new_scene(mesh.plane(2, 1.0), frames=4)
    save_motion(simulate(scene), "m.glb", scene)
    found, _ = read_mesh("m.glb")
    np.testing.assert_allclose(found.positions, scene.cloths[0].positions, atol=2e-5)  # to 1e-5 m
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
     ("a.obj", obj([(0, 0, 0), ("inf", 0, 0), (0, 1, 0)], [(1, 2, 3)]), "line 2: a vertex"),
     ("b.obj", obj([(0, 0, 0), (1e20, 0, 0), (0, 1, 0)], [(1, 2, 3)]), "is not within .* m of the origin; is")],
)  # fmt: skip
def test_what_is_no_mesh_is_refused(folder, name, text, message):
    (folder / name).write_text(text)
    with pytest.raises(InvalidInput, match=f"^{name}.*: .*{message}"):
        read_mesh(name)


@pytest.mark.parametrize(
    ("degrees", "expected"),
    # Unity's axes are left-handed: a quarter turn about y takes z to x, about x takes y to z, about z takes x to y.
    [((0, 90, 0), [[0, 0, -1], [0, 1, 0], [1, 0, 0]]), ((90, 0, 0), [[1, 0, 0], [0, 0, 1], [0, -1, 0]]),
     ((0, 0, 90), [[0, 1, 0], [-1, 0, 0], [0, 0, 1]]),
     ((90, 90, 0), [[0, 0, -1], [1, 0, 0], [0, -1, 0]])],  # about x first: y to z, then with z to x
)  # fmt: skip
def test_turns_are_unitys(degrees, expected):
    np.testing.assert_allclose(turned(np.eye(3), degrees), expected, atol=1e-15)  # of sines and cosines
    turn = turned(np.eye(3), np.add(degrees, (20, -50, 130))).T
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-15)
    assert np.linalg.det(turn) == pytest.approx(1.0, rel=1e-14)
