"""Motions of any format, as those of a scene: axes, unit, rate, frames, what is assumed and what is doubted."""

import io
from dataclasses import replace
from functools import cache
from itertools import product

import numpy as np
import pytest
import trimesh
from helpers.scenes import cloth, document, trial

import clothfit
from clothfit import InvalidInput, InvalidMotion, mesh, read_mesh
from clothfit.cli.program import run
from clothfit.formats import registry
from clothfit.formats.animation import Animation
from clothfit.formats.axes import Axes, Convention, Reading, from_scene
from clothfit.meshes.new_scene import new_scene
from clothfit.motion import files as motion_files
from clothfit.motion import foreign
from clothfit.scene.mesh_numbering import numberings

SCENE = clothfit.load(trial("nG", 5))
AXES = [Axes(up, hand, scale) for up, hand, scale in product("yz", ("left", "right"), (1.0, 0.01))]


@cache
def recorded():
    return clothfit.simulate(SCENE)


def convention(axes):
    return Convention(axes.scale, axes.up, axes.handedness)


def reading(axes, **others):
    return Reading(axes.scale, axes.up, axes.handedness, **others)


@pytest.fixture
def there(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


# --- there and back


def test_the_axes_of_obj_are_y_up_and_right_handed(there):
    clothfit.save_motion(recorded(), "a_*.obj", SCENE)
    first = (there / "a_0000.obj").read_text().splitlines()
    x, y, z = SCENE.cloths[0].positions[5].tolist()
    assert first[5] == f"v {-x!r} {y!r} {z!r}"
    a, b, c = SCENE.cloths[0].triangles[0].tolist()
    assert f"f {c + 1} {b + 1} {a + 1}" in first  # the mirror turns faces round


def test_files_without_a_known_suffix_are_this_programs(there):
    for name in ("a.npz", "a.dat", "a"):
        clothfit.save_motion(recorded(), name)
        np.testing.assert_array_equal(clothfit.load_motion(name, SCENE).positions, recorded().positions)
    file = io.BytesIO()
    clothfit.save_motion(recorded(), file)
    np.testing.assert_array_equal(clothfit.load_motion(io.BytesIO(file.getvalue()), SCENE).times, recorded().times)


@pytest.mark.parametrize("axes", AXES)
def test_npz_may_be_in_other_axes_too(there, axes):
    np.savez("a.npz", positions=from_scene(recorded().positions, axes))
    found = clothfit.load_motion("a.npz", SCENE, reading=reading(axes, fps=10, frames="1:4"))
    np.testing.assert_allclose(found.positions, recorded().positions[1:4], atol=1e-15)
    np.testing.assert_allclose(found.times, [0.1, 0.2, 0.3])


# --- times and frames


def test_frames_keep_their_times(there):
    clothfit.save_motion(recorded(), "a.pc2")
    found = clothfit.load_motion("a.pc2", SCENE, reading=Reading(frames="-2:"))
    np.testing.assert_array_equal(found.times, recorded().times[-2:])
    assert len(found.positions) == 2


@pytest.mark.parametrize(
    ("read", "spacing", "given", "times", "rate"),
    [
        (None, 1.0, None, [0, 0.02, 0.04], "one frame per time step of 0.02 s"),
        (None, 1.0, 10.0, [0, 0.1, 0.2], "10 frames a second as given"),
        (None, 0.5, 10.0, [0, 0.05, 0.1], "10 frames a second as given"),  # samples between frames
        ([0, 0.5, 1], 1.0, None, [0, 0.5, 1], "2 frames a second by its own times"),
        ([0, 0.5, 1], 1.0, 10.0, [0, 0.1, 0.2], "10 frames a second as given"),
        ([1, 1.5, 2.5], 1.0, None, [0, 0.5, 1.5], "by its own times"),
    ],
)
def test_times_are_given_or_the_files_or_the_scenes(pretend, read, spacing, given, times, rate):
    own = None if read is None else np.array(read, float)
    pretend(Animation(recorded().positions[:3], Axes("y", "left"), own, spacing=spacing))
    found = foreign.load("a.pc2", SCENE, Reading(fps=given))
    np.testing.assert_allclose(found.motion.times, times)
    assert rate in found.interpretation.rate


# --- gaps


def test_what_was_not_seen_is_not_observed_and_needs_a_format_that_has_gaps(there, pretend):
    positions = recorded().positions.copy()
    positions[2, 3] = np.nan
    pretend(Animation(positions, Axes("y", "left")))
    found = clothfit.load_motion("a.pc2", SCENE)
    assert np.argwhere(~found.observed).tolist() == [[2, 3]]
    with pytest.raises(InvalidInput, match=r"PC2 point cache cannot leave out positions that were not observed"):
        clothfit.save_motion(found, "a.pc2")
    assert list(there.iterdir()) == []


# --- doubts


def account(there, positions, axes=None, **said):
    """How a motion is read that lies in those axes in its file, with what the user says."""
    motion_files.save_motion(clothfit.as_motion(SCENE, positions), "a.pc2", None, convention(axes or Axes()))
    return foreign.load("a.pc2", SCENE, Reading(**said)).interpretation


@pytest.mark.parametrize("axes", [each for each in AXES if each != Axes()])
def test_other_axes_are_noticed_and_named(there, axes):
    found = account(there, recorded().positions, axes)
    said = [f"--{name} {value}" for name, value in axes._asdict().items() if value != getattr(Axes(), name)]
    (doubt,) = found.doubts
    assert doubt.endswith(f"away from where the scene begins; {' '.join(said)} would fit")


def test_another_place_and_another_order_are_noticed_and_a_few_swapped_vertices_are_neither(there):
    moved, order = recorded().positions + [5.0, 0, -2], np.random.default_rng(0).permutation(16)
    assert account(there, moved).start.advice == "it is moved by (5, 0, -2) m"
    assert account(there, moved, frames="1:").start is None  # later frames are not compared with the start
    assert account(there, recorded().positions[:, order], bind="order").start.advice == (
        "its vertices would fit in another order"
    )
    same = account(there, recorded().positions)
    assert (same.doubts, same.start.distance < 1e-6) == ([], True)
    swapped = recorded().positions.copy()
    swapped[:, [0, 15]] = swapped[:, [15, 0]]
    found = account(there, swapped)
    assert found.doubts == []
    assert found.start.distance > 0.05  # of a sheet of a metre or so: the fit looks at that, and names them
    far = account(there, recorded().positions + [50.0, 0, 0]).start.advice
    assert far == "it is moved by (50, 0, 0) m"  # shrunk to a point it would be fifty times as near, and no cloth
    noise = np.random.default_rng(0).normal(size=recorded().positions.shape)
    assert account(there, recorded().positions + noise).start.advice is None


def test_a_mirror_of_a_symmetric_sheet_is_named_by_the_order_of_its_vertices(there):
    """Its places are those of the sheet, in another order; what the user says of the axes makes it that order."""
    scene = new_scene(sheet := mesh.plane(3, 1.0, 0.7), np.arange(len(sheet.positions)) < 5)
    frames = np.repeat(scene.cloths[0].positions[None], 3, axis=0)
    np.savez("mirror.npz", positions=frames * [-1.0, 1.0, 1.0], times=0.02 * np.arange(3))
    found = foreign.load("mirror.npz", scene, Reading()).interpretation.start
    assert found.advice == "--handedness right would fit"
    for handedness in ("left", "right"):
        own = foreign.load("mirror.npz", scene, Reading(handedness=handedness))
        np.testing.assert_allclose(own.motion.positions, frames, atol=1e-12)
        assert own.interpretation.doubts == []


def test_the_account_tells_what_was_assumed(there):
    found = account(there, recorded().positions, fps=25.0)
    assert str(found) == (
        "a.pc2: PC2 point cache, 5 frames of 16 points, 25 frames a second as given; y up, right-handed, metres"
    )
    expected = {"file": "a.pc2", "format": "PC2 point cache", "up": "y", "handedness": "right", "scale": 1.0}
    assert found.summary() | expected | {"frames": 5, "points": 16} == found.summary()


# --- what does not fit


def test_another_number_of_vertices_is_told_with_both_and_objects_are_in_file_order(there):
    scene = clothfit.load(document(cloth(), cloth(nx=3)))
    clothfit.save_motion(recorded(), "a.pc2")
    with pytest.raises(InvalidMotion, match=r"a\.pc2: has 16 points, scene has 21 .* the mesh that the scene"):
        clothfit.load_motion("a.pc2", scene)
    clothfit.save_motion(clothfit.simulate(scene, 2), "a_*.obj", scene)
    assert clothfit.load_motion("a_*.obj", scene).vertex_counts == (12, 9)
    assert motion_files.triangles_of(scene).max() == 20


WRONG = [{"scale": 0.0}, {"scale": np.inf}, {"fps": -1.0}, {"up": "x"}, {"handedness": "up"}, {"frames": "3"},
         {"frames": "a:b"}, {"frames": "0:1:2"}]  # fmt: skip


@pytest.mark.parametrize("said", WRONG)
def test_what_cannot_be_said(said):
    with pytest.raises(InvalidInput):
        Reading(**said)
    for scale in (1e-60, 1e50):
        with pytest.raises(InvalidInput, match=r"^scale must be 1e-12 to 1e"):
            Convention(scale=scale)


# --- hostile files


def test_a_longer_sequence_is_not_left_behind(there):
    clothfit.save_motion(recorded(), "a_*.obj", SCENE)
    shorter = clothfit.as_motion(SCENE, recorded().positions[:3])
    with pytest.raises(InvalidInput, match=r"a_0003\.obj exists and would be read as one of its frames"):
        clothfit.save_motion(shorter, "a_*.obj", SCENE)
    assert len(clothfit.load_motion("a_*.obj", SCENE).times) == 5
    clothfit.save_motion(recorded(), "a_*.obj", SCENE)  # the same again is written over


@pytest.mark.parametrize("suffix", ["pc2", "mdd", "usda", "c3d", "glb"])
@pytest.mark.parametrize("size", [1e60, 1e-60])
def test_what_single_precision_cannot_hold_is_refused_and_not_written(tmp_path, suffix, size):
    motion = clothfit.Motion(size * np.ones((2, 3, 3)), np.arange(2.0), np.array([3]))
    with pytest.raises(InvalidInput, match=r"do not fit into .*, which has single precision"):
        clothfit.save_motion(motion, tmp_path / f"x.{suffix}")
    assert not list(tmp_path.iterdir())


# --- motions of a mesh that was welded: read by the mesh's numbers, and written with them again

FLOAT32 = 1e-6  # m, of positions of a few metres in single precision


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """`sheet.obj`, a sheet whose triangles share no vertices, with one stray vertex, and `sheet.json` made of it."""
    found = tmp_path_factory.mktemp("welded")
    sheet = mesh.plane(2, 1.0)
    points = np.vstack([sheet.positions[sheet.triangles.reshape(-1)], [[5.0, 5, 5]]]) * [-1, 1, 1]
    rows = [f"v {x!r} {y!r} {z!r}" for x, y, z in points.tolist()]
    rows += ["f {} {} {}".format(*face) for face in (1 + np.arange(54).reshape(-1, 3))[:, ::-1].tolist()]
    (found / "sheet.obj").write_text("\n".join(rows))
    asked = ["--weld", "--fix-side", "left", "--frames", "6", "-o", str(found / "sheet.json"), "-q"]
    assert run(["new", str(found / "sheet.obj"), *asked]) == 0
    return found


@pytest.fixture
def welded(folder, monkeypatch):
    """The scene, whose 16 vertices were the mesh's 55."""
    monkeypatch.chdir(folder)
    found = clothfit.load("sheet.json")
    assert (found.vertex_counts, len(numberings(found)[0])) == ((16,), 55)
    return found


def read_points(name):
    return registry.module_of(registry.foreign(name)).read(name).positions.shape[1]


@pytest.mark.parametrize("name", ["m.pc2", "m.mdd", "m_*.obj", "m.glb"])
def test_what_is_written_has_the_meshs_vertices_and_is_read_by_them(welded, name):
    motion = clothfit.simulate(welded)
    clothfit.save_motion(motion, name, welded)
    assert read_points(name) == 55
    again = clothfit.load_motion(name, welded)
    np.testing.assert_allclose(again.positions, motion.positions, rtol=0, atol=20 * FLOAT32)  # .glb: to 1e-5 m
    assert again.vertex_counts == (16,)


def test_each_vertex_of_the_mesh_goes_with_the_one_it_became(welded):
    motion = clothfit.simulate(welded)
    whole, faces = motion_files.for_tools(motion, welded, registry.foreign("m.pc2"))
    (numbering,) = numberings(welded)
    np.testing.assert_array_equal(whole.positions[:, :54], motion.positions[:, numbering[:54]])
    np.testing.assert_array_equal(numbering[faces], welded.cloths[0].triangles)
    np.testing.assert_allclose(whole.positions[0, :54], read_mesh("sheet.obj")[0].positions[:54], rtol=0, atol=1e-15)
    solid = trimesh.Trimesh(whole.positions[0], faces, process=False)
    assert solid.area == pytest.approx(1.0, rel=1e-12)  # m²


def test_to_npz_and_back_to_the_mesh_and_markers_keep_the_numbers_of_the_scene(welded):
    motion = clothfit.simulate(welded)
    clothfit.save_motion(motion, "m.npz")
    assert run(["convert", "m.npz", "m.pc2", "--scene", "sheet.json", "--mesh", "sheet.obj", "-q"]) == 0
    assert run(["convert", "m.pc2", "again.npz", "--scene", "sheet.json", "-q"]) == 0
    clothfit.save_motion(motion, "m.trc", welded)
    assert (read_points("m.pc2"), read_points("m.trc")) == (55, 16)
    for name in ("again.npz", "m.trc"):
        np.testing.assert_allclose(clothfit.load_motion(name, welded).positions, motion.positions, rtol=0, atol=FLOAT32)


def test_another_count_is_refused(welded):
    motion = clothfit.simulate(welded)
    clothfit.save_motion(motion, "m.pc2")  # without the scene: 16 vertices, which fit as well
    assert clothfit.load_motion("m.pc2", welded).vertex_counts == (16,)
    clothfit.save_motion(replace(motion, positions=motion.positions[:, :9], vertex_counts=(9,)), "few.pc2")
    with pytest.raises(InvalidMotion, match=r"has 9 vertices, sheet\.json has 16"):
        clothfit.load_motion("few.pc2", welded, reading=Reading(bind="order"))
