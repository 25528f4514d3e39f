"""Every format: there and back in any axes to its own precision, damage, garbage, what is not there; axes in closed
forms; files whose content is not what their suffix says.
"""

import gzip
import io
import random
import zipfile
from functools import cache
from itertools import product

import numpy as np
import pytest
from helpers import marker_files
from helpers.files import damaged, read, written
from helpers.paths import TESTS
from helpers.scene_files import wave
from helpers.scenes import trial

import clothfit
from clothfit import InvalidInput, InvalidMotion, read_mesh
from clothfit.base.writing import write_atomically
from clothfit.formats import glb
from clothfit.formats.animation import is_pin
from clothfit.formats.axes import SCENE as OWN
from clothfit.formats.axes import Axes, Convention, Reading, facing, from_scene, to_scene
from clothfit.formats.registry import FORMATS, foreign
from clothfit.formats.registry import read_format as read_known
from clothfit.motion.foreign import load

SCENE = clothfit.load(trial("nG", 5))
LARGEST = 3.0001  # m, that a coordinate of its motion is
HALF = 2.0**-24 * LARGEST  # of the last of float32's 24 bits


@cache
def recorded():
    return clothfit.simulate(SCENE)


def blenders(name):
    return (TESTS / "formats" / "blender" / name).read_bytes()


# Suffix: the largest error of a coordinate, m (text is exact but for the unit), and what the file tells of its axes.
PRECISION = {
    "_*.obj": (0.0, ""), ".pc2": (HALF, ""), ".mdd": (HALF, ""), ".usda": (HALF, "up scale"),
    ".usdc": (HALF, "up scale"), ".glb": (glb.LARGEST_ERROR, ""), ".gltf": (glb.LARGEST_ERROR, ""),
    ".c3d": (HALF, "up scale"), ".trc": (1e-15, "scale"), ".csv": (0.0, "up handedness scale"),
}  # fmt: skip
AXES = [Axes(up, hand, scale) for up, hand, scale in product("yz", ("left", "right"), (1.0, 0.01))]
FEW_OF_USD = {".usda": [None], ".usdc": [Axes("z", "left", 0.01)]}  # which a process reads


# The front is where the cross product of two sides, taken by its formula, points: in either handedness.
@pytest.mark.parametrize("axes", AXES)
def test_axes_keep_lengths_what_is_up_and_the_front_and_only_right_handed_ones_are_mirrored(axes):
    points = np.random.default_rng(0).normal(size=(4, 5, 3))
    assert (to_scene(points, OWN) == points).all()
    np.testing.assert_allclose(from_scene(to_scene(points, axes), axes), points, rtol=4e-16)  # two roundings
    in_place = points.copy()
    assert to_scene(in_place, axes, own=True) is in_place
    np.testing.assert_array_equal(in_place, to_scene(points, axes))
    still = np.broadcast_to(points[0], points.shape)  # one frame for all, which must not be turned four times
    np.testing.assert_array_equal(to_scene(still, axes, own=True), to_scene(still, axes))
    image = to_scene(np.eye(3), axes) / axes.scale
    np.testing.assert_array_equal(image["xyz".index(axes.up)], [0, 1, 0])
    assert np.linalg.det(image) == pytest.approx(-1 if axes.handedness == "right" else 1)
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 2, 1]])
    (a, b, c), image = facing(np.array([[0, 1, 2]]), axes)[0], to_scene(corners, axes)
    front = to_scene(np.cross(corners[1] - corners[0], corners[2] - corners[0]), axes)
    assert np.dot(front, np.cross(image[b] - image[a], image[c] - image[a])) > 0


def library(name):
    """Skip what needs a library that is missing."""
    if foreign(name).library is not None:
        pytest.importorskip(foreign(name).library)


@pytest.mark.parametrize(
    ("suffix", "axes"),
    [(suffix, axes) for suffix in PRECISION for axes in FEW_OF_USD.get(suffix, (None, *AXES))],
)
def test_a_motion_comes_back_in_any_axes_to_the_precision_of_the_format(tmp_path, suffix, axes):
    library(f"a{suffix}")
    name, (error, told) = str(tmp_path / f"a{suffix}"), PRECISION[suffix]
    said = {} if axes is None else axes._asdict()
    assert np.abs(recorded().positions).max() == pytest.approx(LARGEST, rel=1e-4)
    clothfit.save_motion(recorded(), name, SCENE, Convention(**said))
    reading = Reading(**{field: value for field, value in said.items() if field not in told})
    found = clothfit.load_motion(name, SCENE, reading=reading)
    most = error if axes is None else 2 * error + 2e-15 * LARGEST  # the unit costs two roundings
    np.testing.assert_allclose(found.positions, recorded().positions, rtol=0, atol=most)
    np.testing.assert_allclose(found.times, recorded().times, rtol=1.2e-7)  # float32, in glTF, and the rate in C3D
    assert (found.vertex_counts, found.observed) == (recorded().vertex_counts, None)


PLY = (
    "ply\nformat ascii 1.0\nelement vertex 4\nproperty double x\nproperty double y\nproperty double z\n"
    "element face 2\nproperty list uchar int vertex_indices\nend_header\n"
    "0 0 0\n1 0 0\n1 1 0\n0 1 0.1\n3 0 1 2\n4 0 1 2 3\n"
)
OBJ = b"v 0 0 0\nvt 0 1\nv 1 0 0\nv 1 1 0\ng hem\nf 1/1/1 -2//3 3 \\\n 3\nv 0 1 0\nf 1 3 4\n"


def goods(suffix):
    """Good files of a format."""
    if suffix in ("c3d", "trc", "csv"):
        more = [marker_files.LONG.encode(), marker_files.MOTIVE.encode()] if suffix == "csv" else []
        return [written(f"a.{suffix}", marker_files.motion()), *more]
    if suffix in ("pc2", "mdd", "glb"):
        return [written(f"a.{suffix}", wave(6, count=8))]
    return {"abc": [blenders("sheet.abc")], "stl": [blenders("sheet-text.stl"), blenders("sheet-binary.stl")],
            "ply": [PLY.encode()], "obj": [OBJ]}[suffix]  # fmt: skip


@pytest.mark.parametrize("suffix", ["abc", "stl", "ply", "obj", "pc2", "mdd", "glb", "c3d", "trc", "csv"])
def test_damaged_files_are_refused_or_read_and_nothing_else(tmp_path, suffix):
    chance, files, messages = random.Random(0), goods(suffix), []
    for i in range(300):
        try:
            found = read(tmp_path, f"a.{suffix}", damaged(files[i % len(files)], chance))
        except InvalidMotion as error:
            messages.append(str(error))
            continue
        wrong = np.isinf(found.positions).any(axis=2)  # NaN: not seen
        assert not (wrong if found.observed is None else wrong[found.observed]).any()
        corners = np.zeros(0) if found.triangles is None else found.triangles
        assert ((corners >= 0) & (corners < found.positions.shape[1])).all()
    assert 40 < len(messages) < 300  # so that damage was done
    assert all(text.startswith(f"a.{suffix}: ") and "\n" not in text for text in messages)


GARBAGE = [b"", b"\0", b"hello\n", bytes(2000), b"\xff\xfe\x00", b"\xff" * 99, b"," * 1000, b"\t\n" * 500, b"PK\3\4",
           b"v ", b"POINTCACHE2\0" + b"\x7f" * 99]  # fmt: skip


@pytest.mark.parametrize("suffix", [each for form in FORMATS for each in form.suffixes if form.name != "USD"])
def test_garbage_a_folder_and_nothing_are_refused_with_the_name(tmp_path, suffix):
    for data in GARBAGE:
        with pytest.raises(InvalidMotion, match=rf"a\{suffix}: "):
            read(tmp_path, f"a{suffix}", data)
    (tmp_path / f"a{suffix}").write_bytes(b"")
    with pytest.raises(InvalidMotion, match=rf"^a\{suffix}: it is empty; export it again$"):
        read_known(foreign(f"a{suffix}"), tmp_path / f"a{suffix}")
    (tmp_path / f"b{suffix.upper()}").mkdir()
    for name, message in ((f"b{suffix.upper()}", "is a folder"), (f"c{suffix}", "there is no such file")):
        with pytest.raises(InvalidMotion, match=message):
            clothfit.load_motion(tmp_path / name, SCENE)


@pytest.mark.parametrize("suffix", ["c3d", "trc", "csv"])
def test_gaps_come_back(tmp_path, suffix):
    observed = np.ones(recorded().positions.shape[:2], bool)
    observed[4:7, 5] = False
    name = str(tmp_path / f"a.{suffix}")
    clothfit.save_motion(clothfit.as_motion(SCENE, recorded().positions, recorded().times, observed), name, SCENE)
    np.testing.assert_array_equal(clothfit.load_motion(name, SCENE).observed, observed)


# Half of a sequence looks like a whole one.
@pytest.mark.parametrize("before", [(), ("a_0001.obj",)])
def test_a_sequence_that_cannot_be_written_whole_leaves_nothing_new(tmp_path, before, monkeypatch):
    for name in before:
        (tmp_path / name).write_text("old")

    def full(path, data):
        if path.endswith("2.obj"):
            raise InvalidInput("cannot write")
        write_atomically(path, data)

    monkeypatch.setattr(clothfit.motion.files, "write_atomically", full)
    with pytest.raises(InvalidInput, match="cannot write"):
        clothfit.save_motion(recorded(), str(tmp_path / "a_*.obj"), SCENE)
    assert [path.name for path in tmp_path.glob("a_*")] == list(before)


# Files whose content is not what their suffix says: the message says what they are.


PAGE = b"<!DOCTYPE html>\n<html><head><title>404</title></head></html>"
POINTER = b"version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 9\n"


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.usdc", blenders("sheet.abc"), "its content is Alembic; rename it to .abc"),
        ("a.usdc", b"", "it is empty; export it again"),
        ("a.abc", blenders("sheet.usdc"), "its content is USD; rename it to .usdc"),
        ("a.obj", blenders("sheet-text.stl"), "its content is STL; rename it to .stl"),
        ("a.stl", blenders("sheet.glb"), "its content is glTF; rename it to .glb"),
        ("a.obj", gzip.compress(b"v 0 0 0\n", mtime=0), "it is a gzip archive; unpack it"),
        ("a.glb", PAGE, "it is a web page; download the file itself"),
        ("a.csv", POINTER, "it is a pointer of Git LFS, not the file itself; fetch that with: git lfs pull"),
        ("a.obj", b"OFF\n3 1 0\n", "it is an OFF mesh; export it as .ply, .stl or .obj"),
        ("a.obj", b"# vtk DataFile Version 3.0\n", "it is a VTK file; export it as .ply, .stl or .obj"),
        ("a.obj", b"$MeshFormat\n4.1 0 8\n", "it is a Gmsh mesh; export it as .ply, .stl or .obj"),
        ("a.abc", b'<?xml version="1.0"?><COLLADA/>', "it is an XML file, as COLLADA's and VTK's are; export it "
                  "as .glb, .usd, .abc or .obj"),
        ("a.glb", b"\xff\xd8\xff\xe0", "it is a picture; name another file"),
        ("a.pc2", b"BLENDER-v402", "it is a Blender file; export it as .glb, .usd, .abc or .obj"),
    ],
)  # fmt: skip
def test_a_wrong_suffix_is_named(tmp_path, name, content, message):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InvalidMotion) as caught:
        read_known(foreign(name), tmp_path / name)
    assert str(caught.value) == f"{name}: {message}"


def packed(name):
    """A zip archive of one file."""
    with zipfile.ZipFile(out := io.BytesIO(), "w") as archive:
        archive.writestr(name, b"anything")
    return out.getvalue()


# A file with any suffix may be one of this program's, as a pipe has no name.
def test_an_unknown_suffix_is_refused_unless_the_content_is_known(tmp_path):
    np.savez(tmp_path / "other.npz", vertices=np.zeros(3))
    for name, content, message in (
        ("a.vtk", b"hello", r"no motion format has that suffix; known are .*; export it as one"),
        ("a.fbx", (tmp_path / "other.npz").read_bytes(), r"its content is NumPy; rename it to \.npz"),
        ("a.usdz", packed("shirt.usdc"), "it is a USDZ package; unpack it, as a zip archive, and name the USD file in"),
        ("a.zip", packed("shirt.png"), "it is a zip archive; unpack it"),
    ):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(InvalidInput, match=rf"{name}: {message}"):
            load(tmp_path / name, None, Reading())
        with pytest.raises(InvalidInput, match=rf"{name}: {message.replace('motion', 'mesh')}"):
            read_mesh(tmp_path / name)
    positions = np.random.default_rng(0).normal(size=(2, 4, 3))
    for name, save in (
        ("a.motion", lambda file: np.savez(file, positions=positions)),
        ("a.dat", lambda file: np.save(file, positions)),
    ):
        with open(tmp_path / name, "wb") as file:
            save(file)
        np.testing.assert_array_equal(load(tmp_path / name, None, Reading()).motion.positions, positions)


def test_groups_of_bones_hold_nothing():
    pins = ["pin", "Pinned", "_PIN", "ClothPin", "hem.pins"]
    bones = ["spine", "Spine.001", "SPINE", "mixamorig:LeftHandPinky1", "f_pinky.01.L"]
    assert [name for name in (*pins, *bones) if is_pin(name)] == pins
