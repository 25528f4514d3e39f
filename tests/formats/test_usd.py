"""USD files: written by Pixar's library and read, written and read by it, damaged."""

import json
import os
import random
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from helpers.files import damaged
from helpers.paths import TESTS
from pxr import Gf, Sdf, Usd, UsdGeom, Vt

from clothfit.base.errors import InvalidMotion
from clothfit.base.writing import write_atomically
from clothfit.formats import usd, usd_reader
from clothfit.formats.animation import Animation
from clothfit.formats.axes import RIGHT, Axes

pytestmark = pytest.mark.slow  # starts processes

CORNERS = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0.5, 2, 0]])
FRAMES = np.stack([CORNERS + f for f in range(3)])
SIZES, POLYGONS = [4, 3], [0, 1, 2, 3, 2, 4, 3]
FANS = [[0, 1, 2], [0, 2, 3], [2, 4, 3]]


def points(values):
    return Vt.Vec3fArray.FromNumpy(np.asarray(values, np.float32))


def mesh(stage, path, frames=FRAMES, codes=(1, 2, 3), sizes=SIZES, corners=POLYGONS):
    """A mesh with samples at codes, or without any."""
    made = UsdGeom.Mesh.Define(stage, path)
    for code, frame in zip(codes, frames, strict=False):
        made.GetPointsAttr().Set(points(frame), code)
    if not codes:
        made.GetPointsAttr().Set(points(frames[0]))
    made.GetFaceVertexCountsAttr().Set(sizes)
    made.GetFaceVertexIndicesAttr().Set(corners)
    return made


@pytest.fixture
def stage(tmp_path):
    """A new file, z up, in centimetres, 50 codes a second."""
    made = Usd.Stage.CreateNew(str(tmp_path / "a.usda"))
    UsdGeom.SetStageUpAxis(made, UsdGeom.Tokens.z)
    UsdGeom.SetStageMetersPerUnit(made, 0.01)
    made.SetTimeCodesPerSecond(50)
    return made


def read(stage):
    """What is in a file, read in this process, which is quicker."""
    stage.GetRootLayer().Save()
    return usd_reader.parsed(stage.GetRootLayer().realPath, "a.usda")


def written(path, animation):
    (data,) = usd.encoded(path, animation).values()
    write_atomically(path, data)


def motion(axes=RIGHT, frames=5, triangles=True, times=None):
    positions = np.random.default_rng(0).normal(size=(frames, 6, 3))
    faces = np.array([[0, 1, 2], [3, 4, 5]], np.int32) if triangles else None
    return Animation(positions, axes, 0.02 * np.arange(frames) if times is None else times, faces)


def test_axes_unit_times_points_and_fans_of_a_file_of_another_program(stage):
    mesh(stage, "/cloth")
    found = read(stage)
    assert found.axes == Axes("z", "right", 0.01)
    np.testing.assert_array_equal(found.positions, FRAMES)
    np.testing.assert_allclose(found.times, [0.02, 0.04, 0.06], rtol=4e-16)  # one division
    np.testing.assert_array_equal(found.triangles, FANS)
    assert found.notes == ()


def test_transforms_are_applied_also_where_they_change_and_what_is_only_carried_moves_with_it(stage):
    move = UsdGeom.Xform.Define(stage, "/up").AddTranslateOp()
    move.Set(Gf.Vec3d(0, 0, 7))
    scale = mesh(stage, "/up/cloth").AddScaleOp()
    for code in (1, 2, 3):
        scale.Set(Gf.Vec3f(code, 1, 1), code)
    expected = FRAMES * np.array([[1, 1, 1], [2, 1, 1], [3, 1, 1]])[:, None] + [0, 0, 7]
    np.testing.assert_array_equal(read(stage).positions, expected)
    stage.RemovePrim("/up/cloth")
    move.Set(Gf.Vec3d(0, 0, 0), 0)
    move.Set(Gf.Vec3d(0, 0, 5), 50)
    mesh(stage, "/up/other", codes=())
    found = read(stage)
    np.testing.assert_array_equal(found.times, [0, 1])
    np.testing.assert_array_equal(found.positions, [CORNERS, CORNERS + [0, 0, 5]])


def test_meshes_follow_each_other_and_still_ones_are_left_out(stage):
    mesh(stage, "/a")
    mesh(stage, "/floor", codes=())
    mesh(stage, "/z", FRAMES + 10)
    found = read(stage)
    np.testing.assert_array_equal(found.positions, np.concatenate([FRAMES, FRAMES + 10], axis=1))
    np.testing.assert_array_equal(found.triangles, np.concatenate([FANS, np.add(FANS, 5)]))
    assert "1 mesh keeps its shape and is left out" in found.notes[0]


@pytest.mark.parametrize(("scale", "left", "turned"), [(1, True, True), (-1, False, True), (-1, True, False)])
def test_the_front_of_faces_stays_the_front(stage, scale, left, turned):
    made = mesh(stage, "/cloth")
    made.AddScaleOp().Set(Gf.Vec3f(scale, 1, 1))
    if left:
        made.CreateOrientationAttr(UsdGeom.Tokens.leftHanded)
    np.testing.assert_array_equal(read(stage).triangles, np.array(FANS)[:, ::-1] if turned else FANS)


# Whatever a file refers to stays closed: the other file has a mesh, and is not found in the result.
def test_other_files_are_not_opened(stage, tmp_path):
    other = Usd.Stage.CreateNew(str(tmp_path / "other.usda"))
    mesh(other, "/theirs")
    other.SetDefaultPrim(other.GetPrimAtPath("/theirs"))
    other.GetRootLayer().Save()
    mesh(stage, "/ours")
    stage.DefinePrim("/reference").GetReferences().AddReference("./other.usda")
    stage.DefinePrim("/payload").GetPayloads().AddPayload("./other.usda")
    stage.GetRootLayer().subLayerPaths.append("./other.usda")
    prim = stage.GetPrimAtPath("/ours")
    Usd.ClipsAPI(prim).SetClipAssetPaths([Sdf.AssetPath("./other.usda")])
    found = read(stage)
    np.testing.assert_array_equal(found.positions, FRAMES)
    assert "other files, which are not read" in found.notes[0]
    stage.RemovePrim("/ours")
    with pytest.raises(InvalidMotion, match="flatten it first"):
        read(stage)


@pytest.mark.parametrize("suffix", ["usd", "usda", "usdc"])
@pytest.mark.parametrize("axes", [RIGHT, Axes("z", "right", 0.01)])
def test_pixars_library_finds_what_was_written(tmp_path, suffix, axes):
    path, own = str(tmp_path / f"a.{suffix}"), motion(axes)
    written(path, own)
    stage = Usd.Stage.Open(path)
    (prim,) = stage.Traverse()
    made = UsdGeom.Mesh(prim)
    assert (UsdGeom.GetStageUpAxis(stage).lower(), UsdGeom.GetStageMetersPerUnit(stage)) == (axes.up, axes.scale)
    assert made.GetPointsAttr().GetTimeSamples() == [0, 1, 2, 3, 4]
    assert stage.GetTimeCodesPerSecond() == 50
    found = [made.GetPointsAttr().Get(code) for code in range(5)]
    np.testing.assert_array_equal(found, own.positions.astype(np.float32))
    np.testing.assert_array_equal(np.reshape(made.GetFaceVertexIndicesAttr().Get(), (-1, 3)), own.triangles)
    np.testing.assert_array_equal(made.GetExtentAttr().Get(2), [np.min(found[2], 0), np.max(found[2], 0)])
    assert stage.GetDefaultPrim() == prim


# USD's points are float32; times are codes divided by the rate.
UNEVEN = np.array([0, 0.1, 0.5, 0.6, 2])


@pytest.mark.parametrize("own", [motion(), motion(triangles=False), motion(frames=1), motion(times=UNEVEN)])
def test_round_trip_to_float32(tmp_path, own):
    path = str(tmp_path / "a.usdc")
    written(path, own)
    found = usd_reader.parsed(path, "a")
    np.testing.assert_array_equal(found.positions, own.positions.astype(np.float32))
    np.testing.assert_allclose(found.times if len(own.times) > 1 else [0.0], own.times, rtol=1e-15)
    assert found.notes == ()


# The library itself may fall over such files, which is why it works in another process: each end is one that `usd.read`
# has a sentence for, and none takes long, which a promise of much memory would.
@pytest.mark.parametrize(("suffix", "count"), [("usda", 10), ("usdc", 30)])
def test_damaged_files_end_the_reading_only(tmp_path, suffix, count):
    path = str(tmp_path / f"a.{suffix}")
    written(path, motion())
    good, chance, paths = Path(path).read_bytes(), random.Random(0), [tmp_path / f"{i}.{suffix}" for i in range(count)]
    for each in paths:
        each.write_bytes(damaged(good, chance))
    command = [sys.executable, str(TESTS / "helpers" / "usd_children.py"), *map(str, paths)]
    around = {**os.environ, "TMPDIR": str(tmp_path), "PYTHONPATH": os.pathsep.join(sys.path), **usd.ALONE}
    done = subprocess.run(command, env=around, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, check=True)
    ends = json.loads(done.stdout)
    assert len(ends) == count
    assert -signal.SIGALRM not in ends
    assert ends.count(0) < 0.8 * count  # so that damage was done


def test_garbage_and_a_library_that_falls_over_are_refused_in_one_sentence_and_leave_nothing(
    tmp_path, monkeypatch, capfd
):
    (tmp_path / "a.usd").write_bytes(b"PXR-USDC\0\0")
    with pytest.raises(InvalidMotion, match=r"a\.usd: the USD library cannot read it"):
        usd.read(tmp_path / "a.usd")
    assert capfd.readouterr() == ("", "")
    monkeypatch.setattr(usd, "READER", "faulthandler_abort")
    (tmp_path / "faulthandler_abort.py").write_text("import os\nos.abort()\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    (tmp_path / "a.usd").write_bytes(b"#usda 1.0\n")
    before = sorted(tmp_path.iterdir())
    with pytest.raises(InvalidMotion, match="the USD library cannot read it"):
        usd.read(tmp_path / "a.usd")
    assert sorted(each for each in tmp_path.iterdir() if each.name != "__pycache__") == before


# A file size that no file may exceed stands for a full disk: the system refuses the same way.
def test_a_full_disk_is_told_in_one_line_and_leaves_nothing(tmp_path):
    code = (
        "import resource, signal, sys\n"
        "signal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (300, 300))\n"
        "import numpy as np\n"
        "from clothfit.formats.animation import Animation\n"
        "from clothfit.formats.axes import Axes\n"
        "from clothfit.formats import usd\n"
        "from clothfit.base.writing import write_atomically\n"
        "((path, data),) = usd.encoded(sys.argv[1], Animation(np.ones((9, 99, 3)), Axes('y', 'right'))).items()\n"
        "try:\n"
        "    write_atomically(path, data)\n"
        "except Exception as error:\n"
        "    print(type(error).__name__, error)\n"
    )
    path = str(tmp_path / "a.usdc")
    done = subprocess.run([sys.executable, "-c", code, path], capture_output=True, check=False, timeout=50, text=True)
    assert done.stdout == f"InvalidInput cannot write {path}: the USD library cannot write it; is the disk full?\n"
    assert list(tmp_path.iterdir()) == []


def test_reading_ends_by_its_own_time_and_not_while_other_work_keeps_it_waiting():
    code = "import time; from clothfit.formats.usd_reader import limit_time; limit_time(1.0 + time.process_time())\n"
    waits, computes = (
        subprocess.run([sys.executable, "-c", code + then], check=False, timeout=300).returncode
        for then in ("time.sleep(3.0)", "while True: pass")
    )
    assert waits == 0
    assert computes == -signal.SIGXCPU


@pytest.mark.parametrize("where", ["vertex", "faceVarying"])
@pytest.mark.parametrize("turned", [False, True])
def test_texture_coordinates_and_subsets(stage, where, turned):
    """A left-handed mesh turns the corners of its triangles, and their texture with them."""
    first, other = mesh(stage, "/one"), mesh(stage, "/two", frames=FRAMES + 9)
    if turned:
        first.GetOrientationAttr().Set(UsdGeom.Tokens.leftHanded)
    corners = CORNERS if where == "vertex" else CORNERS[POLYGONS]
    made = UsdGeom.PrimvarsAPI(first).CreatePrimvar("UVMap", Sdf.ValueTypeNames.TexCoord2fArray, where)
    made.Set(Vt.Vec2fArray.FromNumpy(np.ascontiguousarray(corners[:, :2], np.float32)))
    UsdGeom.Subset.CreateGeomSubset(other, "hem", UsdGeom.Tokens.face, Vt.IntArray([1]))
    found = read(stage)
    assert found.texture[:3] == pytest.approx(found.positions[0][found.triangles[:3], :2])
    assert np.isnan(found.texture[3:]).all()
    names = [("one", [0, 1, 2, 3, 4]), ("two", [5, 6, 7, 8, 9]), ("hem", [7, 8, 9])]
    # the process that reads tells the same
    for each in (found, usd.read(stage.GetRootLayer().realPath)) if turned and where == "vertex" else (found,):
        for name in ("positions", "times", "triangles", "texture"):
            np.testing.assert_array_equal(getattr(found, name), getattr(each, name))
        assert (found.axes, found.notes) == (each.axes, each.notes)
        assert [(name, own.tolist()) for name, own in each.parts] == names


def test_what_a_file_does_not_tell_is_as_usd_says(tmp_path):
    made = Usd.Stage.CreateNew(str(tmp_path / "a.usda"))
    still = mesh(made, "/cloth", codes=())
    found = read(made)
    assert (found.axes, found.times, len(found.notes)) == (Axes("y", "right", 0.01), None, 2)
    np.testing.assert_array_equal(found.positions, [CORNERS])
    for code, frame in zip((1, 2, 3), FRAMES, strict=True):
        still.GetPointsAttr().Set(points(frame), code)
    found = read(made)
    np.testing.assert_allclose(found.times, np.array([1, 2, 3]) / 24)
    assert len(found.notes) == 3
