"""OBJ files and sequences: closed forms, the round trip to the last bit, an independent reader, hostile text."""

import io
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import trimesh
from helpers import files

from clothfit.base.errors import InvalidInput, InvalidMotion
from clothfit.base.writing import write_atomically
from clothfit.formats import obj
from clothfit.formats.animation import Animation
from clothfit.formats.axes import RIGHT

SQUARE = b"v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"
CORNERS = [[[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]]
FAN = [[0, 1, 2], [0, 2, 3]]


@pytest.fixture
def read(tmp_path):
    return partial(files.read, tmp_path, "a.obj")


def wild(frames=3, points=7):
    """Numbers of all sizes, which only their full digits give back."""
    rng = np.random.default_rng(0)
    return rng.normal(size=(frames, points, 3)) * 10.0 ** rng.integers(-12, 12, (frames, points, 3))


# --- what a file says


@pytest.mark.parametrize(
    "faces",
    [
        b"f 1 2 3 4",
        b"f -4 -3 -2 -1",
        b"f 1/1 2/2 3/3 4/4",
        b"f 1//1 2//1 3//1 4//1",
        b"f 1/1/1 2/2/1 3/3/1 4/4/1 # a square",
        b"f 1 2 3\nf 1 3 4",
        b"  f\t1 2 \\\n 3 4  ",
        b"g left\nf 1 2 3\no other\ns 1\nusemtl red\nf 1 3 4",
    ],
)
def test_faces_in_all_their_spellings(read, faces):
    found = read(SQUARE + faces)
    assert found.triangles.tolist() == FAN
    assert found.positions.tolist() == CORNERS
    assert (found.axes, found.times) == (RIGHT, None)


@pytest.mark.parametrize(
    "data",
    [
        b"\xef\xbb\xbf" + SQUARE,
        SQUARE.replace(b"\n", b"\r\n"),
        SQUARE.replace(b"\n", b"\r"),
        SQUARE.replace(b" ", b"\t"),
        b"# v 9 9 9\nvt 9 9\nvn 9 9 9\n" + SQUARE + b"vp 9 9\n",
        b"v 0 0 0 1\nv 1 0 0 0.5 0.5 0.5\nv 1.0 1e0 -0 # there\nv 0 \\\n 1 0",
    ],
)
def test_vertices_in_all_their_spellings(read, data):
    found = read(data)
    assert found.positions.tolist() == CORNERS
    assert found.triangles is None


def test_a_negative_corner_counts_from_its_own_line(read):
    found = read(b"v 0 0 0\nv 1 0 0\nv 1 1 0\nf -3 -2 -1\nv 0 0 1\nv 1 0 1\nv 1 1 1\nf -3 -2 -1\n")
    assert found.triangles.tolist() == [[0, 1, 2], [3, 4, 5]]


# --- sequences


def test_a_sequence_comes_back_to_the_last_bit(tmp_path):
    path = str(tmp_path / "a_*.obj")
    for name, data in obj.encoded(path, Animation(wild(), RIGHT, triangles=np.array(FAN, np.int32))).items():
        write_atomically(name, data)
    assert sorted(each.name for each in tmp_path.iterdir()) == ["a_0000.obj", "a_0001.obj", "a_0002.obj"]
    found = obj.read(path)
    np.testing.assert_array_equal(found.positions, wild())
    assert found.triangles.tolist() == FAN


@pytest.mark.parametrize("numbers", [(8, 9, 10, 11), (0, 10, 20)])
def test_frames_are_in_the_order_of_their_numbers(tmp_path, numbers):
    for number in numbers:
        (tmp_path / f"a{number}.obj").write_bytes(b"v %d 0 0" % number)
    (tmp_path / "a_old.obj").write_bytes(b"v 0 0 0")
    assert obj.read(tmp_path / "a*.obj").positions[:, 0, 0].tolist() == list(numbers)


def test_another_program_reads_what_is_written_and_what_it_writes_is_read(read):
    data = files.written("one.obj", Animation(wild(1), RIGHT, triangles=np.array(FAN, np.int32)))
    mesh = trimesh.load(io.BytesIO(data), file_type="obj", process=False, maintain_order=True)
    np.testing.assert_allclose(mesh.vertices, wild(1)[0], rtol=1e-15)
    assert mesh.faces.tolist() == FAN
    mesh = trimesh.creation.icosphere(subdivisions=2)
    found = read(trimesh.exchange.obj.export_obj(mesh, digits=17).encode())
    np.testing.assert_allclose(found.positions[0], mesh.vertices, rtol=1e-15, atol=1e-16)  # 17 decimals
    assert found.triangles.tolist() == mesh.faces.tolist()


def test_many_frames_need_a_place_for_their_numbers():
    with pytest.raises(InvalidInput, match=r"a\.obj: holds one frame, there are 3; write a_\*\.obj"):
        obj.encoded("a.obj", Animation(wild(), RIGHT))


# --- what is wrong


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "has no vertices"),
        (b"\x00\xff" * 999, "has no vertices"),
        (b"v 1 2 3\nv 1 2\n", "line 2: a vertex needs three finite numbers"),
        (b"v\nv 1 2 3\n", "line 1: a vertex"),
        (b"v 1 2 3\r\n\r\nv 1 2 x\r\n", "line 3: a vertex"),
        (b"v 1 2 \\\n 3\nv 1 inf 3", "line 3: a vertex"),
        (b"v 1 2 1e999", "line 1: a vertex"),
        (SQUARE + b"f 1 2", "line 5: a face needs three corners"),
        (SQUARE + b"f 1 2 0", "line 5: a face"),
        (SQUARE + b"f 1 2 5", "line 5: a face"),
        (SQUARE + b"f -5 2 3", "line 5: a face"),
        (SQUARE + b"f 1 2 x", "line 5: a face"),
        (SQUARE + b"f 1 2 " + b"9" * 9999, "line 5: a face"),
        (SQUARE + b"f " + b"1 " * 999_999, "line 5: a face"),
    ],
)
def test_wrong_text_is_told_with_its_line(read, data, message):
    with pytest.raises(InvalidMotion, match=f"a.obj: {message}"):
        read(data)


@pytest.mark.parametrize(
    ("sequence", "message"),
    [
        ({}, "there is no file of that name with a number"),
        ({"a1.obj": SQUARE, "a01.obj": SQUARE}, "a01.obj and a1.obj are both frame 1"),
        ({"a1.obj": SQUARE, "a4.obj": SQUARE, "a6.obj": SQUARE}, "number 4 is none of 1, 3, 5 …"),
        ({"a1.obj": SQUARE, "a2.obj": SQUARE, "a4.obj": SQUARE, "a8.obj": SQUARE}, "only 4 of 8 frames are there"),
        ({"a1.obj": SQUARE, "a2.obj": SQUARE + b"v 0 0 0"}, "a2.obj: has 5 vertices, a1.obj has 4"),
        ({"a1.obj": SQUARE + b"f 1 2 3", "a2.obj": SQUARE + b"f 1 2 3\nf 1 3 4"}, "a2.obj: has other faces"),
        ({"a1.obj": SQUARE, "a2.obj": b"v 1 2"}, "a2.obj: line 1"),
    ],
)
def test_wrong_sequences(tmp_path, sequence, message):
    for name, data in sequence.items():
        (tmp_path / name).write_bytes(data)
    with pytest.raises(InvalidMotion, match=message):
        obj.read(tmp_path / "a*.obj")


@pytest.mark.parametrize("path", ["a*/b.obj", "a*b*.obj", "nowhere/a*.obj", "nowhere.obj", "", "\0.obj", ".", "a\0*"])
def test_no_such_files(tmp_path, monkeypatch, path):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InvalidMotion):
        obj.read(Path(path) if "\0" not in path and path else path)


def test_frames_that_are_missing_were_not_seen(tmp_path):
    for number in (2, 4, 10):
        (tmp_path / f"a{number}.obj").write_bytes(SQUARE)
    found = obj.read(tmp_path / "a*.obj")
    assert np.isnan(found.positions).all(axis=(1, 2)).tolist() == [False, False, True, True, False]
    assert found.notes == ("2 frames are missing and count as not seen",)
