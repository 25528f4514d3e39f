"""Meshes in .ply: those that trimesh writes, polygons of all kinds, and files that nobody should believe."""

import struct
from functools import partial

import numpy as np
import pytest
import trimesh
from helpers import files

from clothfit import InvalidMotion
from clothfit.formats.axes import RIGHT

HEADER = """ply
format {} 1.0
comment made by hand
element vertex {}
property double x
property double y
property double z
"""
FACES = "element face {}\nproperty list uchar int vertex_indices\nend_header\n"
CORNERS = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0.1, 2 / 3, 1e-9]])
FLOAT32 = 6e-8  # relative: trimesh writes single precision


@pytest.fixture
def read(tmp_path):
    return partial(files.read, tmp_path, "mesh.ply")


def ascii_file(faces, points=CORNERS, numbers=repr):
    rows = [" ".join(map(numbers, row)) for row in points.tolist()]
    rows += [" ".join(map(str, [len(face), *face])) for face in faces]
    return (HEADER.format("ascii", len(points)) + FACES.format(len(faces)) + "\n".join(rows)).encode()


def binary_file(faces, order, points=CORNERS):
    name = {"<": "binary_little_endian", ">": "binary_big_endian"}[order]
    body = points.astype(f"{order}f8").tobytes()
    body += b"".join(struct.pack(f"{order}B{len(face)}i", len(face), *face) for face in faces)
    return (HEADER.format(name, len(points)) + FACES.format(len(faces))).encode() + body


@pytest.mark.parametrize("encoding", ["ascii", "binary"])
@pytest.mark.parametrize("normals", [False, True])
def test_what_trimesh_writes(read, encoding, normals):
    solid = trimesh.creation.icosphere(2)
    data = trimesh.exchange.ply.export_ply(solid, encoding=encoding, vertex_normal=normals)
    found = read(data)
    assert found.positions.shape == (1, 162, 3)
    np.testing.assert_allclose(found.positions[0], solid.vertices, rtol=0, atol=FLOAT32)
    np.testing.assert_array_equal(found.triangles, solid.faces)
    assert found.axes == RIGHT
    assert found.triangles.dtype == np.int32


FANS = {
    "triangles": ([[0, 1, 2], [0, 2, 3]], [[0, 1, 2], [0, 2, 3]]),
    "quads": ([[0, 1, 2, 3], [1, 2, 3, 4]], [[0, 1, 2], [0, 2, 3], [1, 2, 3], [1, 3, 4]]),
    "mixed": ([[0, 1, 2, 3, 4], [4, 3, 2], [0, 1]], [[0, 1, 2], [0, 2, 3], [0, 3, 4], [4, 3, 2]]),
    "mixed, the first the longest": ([[0, 1, 2, 3], [4, 3, 2]], [[0, 1, 2], [0, 2, 3], [4, 3, 2]]),
}


@pytest.mark.parametrize("kind", FANS)
@pytest.mark.parametrize("order", ["", "<", ">"])
def test_polygons_become_fans_and_doubles_come_back_as_they_were(read, kind, order):
    faces, triangles = FANS[kind]
    found = read(binary_file(faces, order) if order else ascii_file(faces))
    np.testing.assert_array_equal(found.positions[0], CORNERS)
    np.testing.assert_array_equal(found.triangles, triangles)


def test_other_elements_and_properties_are_passed_over(read):
    text = b"""ply
format ascii 1.0
obj_info something
element camera 1
property float view
property list uchar float values
element vertex 3
property uchar red
property float z
property float y
property list uchar short tags
property float x
element face 1
property uchar flags
property list uchar uint vertex_index
property list uchar float texcoord
end_header
7 2 1 2
255 3 2 1 9 1
255 6 5 0 4
255 9 8 2 1 2 7
1 3 0 1 2 6 0 0 0 0 0 0
"""
    found = read(text)
    np.testing.assert_array_equal(found.positions[0], [[1, 2, 3], [4, 5, 6], [7, 8, 9]])
    assert found.triangles.tolist() == [[0, 1, 2]]


GOOD = binary_file([[0, 1, 2], [0, 2, 3]], "<")
MIXED = binary_file([[0, 1, 2, 3], [0, 2, 3]], "<")
TEXT = ascii_file([[0, 1, 2], [0, 2, 3]])
HOSTILE = {
    "empty": b"",
    "an image": b"\x89PNG\r\n\x1a\n" + bytes(100),
    "only a header": GOOD[: GOOD.index(b"end_header") + 11],
    "no end of the header": GOOD[:60],
    "a header without end": b"ply\n" + b"comment\n" * 100_000,
    "a body that is cut": GOOD[:-1],
    "a mixed body that is cut": MIXED[:-1],
    "a text that is cut": TEXT[:-3],
    "billions of vertices": GOOD.replace(b"vertex 5", b"vertex 9000000000000"),
    "billions of faces": TEXT.replace(b"face 2", b"face 9000000000000"),
    "a count beyond all numbers": GOOD.replace(b"vertex 5", b"vertex " + b"9" * 5000),
    "a negative count": GOOD.replace(b"vertex 5", b"vertex -5"),
    "a list of billions": ascii_file([[0, 1, 2]]).replace(b"\n3 0", b"\n3000000000 0"),
    "a list of less than nothing": ascii_file([[0, 1, 2]]).replace(b"\n3 0", b"\n-3 0"),
    "a list of nan": ascii_file([[0, 1, 2]]).replace(b"\n3 0", b"\nnan 0"),
    "a list of inf": ascii_file([[0, 1, 2]]).replace(b"\n3 0", b"\ninf 0"),
    "a vertex that is not there": ascii_file([[0, 1, 5]]),
    "a vertex before the first": ascii_file([[0, 1, -1]]),
    "half a vertex": ascii_file([[0, 1, 2]]).replace(b"0 1 2", b"0 1 1.5"),
    "a vertex that is no number": ascii_file([[0, 1, 2]]).replace(b"0 1 2", b"0 1 nan"),
    "text that is none": TEXT.replace(b"1.0 1.0", b"1.0 \xff"),
    "the same property twice": GOOD.replace(b"double y", b"double x"),
    "a type that is none": GOOD.replace(b"double y", b"object y"),
    "a property of nothing": GOOD.replace(b"element vertex 5\n", b""),
    "another format": GOOD.replace(b"binary_little_endian", b"binary_middle_endian"),
    "no format": TEXT.replace(b"format ascii 1.0\n", b""),
    "faces that are no lists": TEXT.replace(b"list uchar int", b"int"),
}
SAID = {  # of some, what is said of them
    "billions of vertices": "bytes where its header asks for ", "no format": "its header does not name the format",
    "a vertex that is not there": "a face names vertex 5; there are 5",
    "faces that are no lists": "its faces are not lists of vertices",
}  # fmt: skip


def test_what_is_odd_but_right_is_read(read):
    assert read(HEADER.format("ascii", 1) + "end_header\n1 2 3").triangles is None  # points alone
    air = GOOD.replace(b"end_header", b"element air 999999999999999999\nend_header")  # many of nothing
    for data in (air, TEXT.replace(b"\n", b"\r\n")):
        np.testing.assert_array_equal(read(data).positions[0], CORNERS)


@pytest.mark.parametrize("kind", HOSTILE)
def test_a_file_that_cannot_be_is_one_sentence(read, kind):
    with pytest.raises(InvalidMotion, match=r"^mesh\.ply: cannot be read as \.ply: ") as caught:
        read(HOSTILE[kind])
    assert "\n" not in str(caught.value)
    assert SAID.get(kind, "") in str(caught.value)


def test_lists_beyond_the_memory_are_refused(read, monkeypatch):
    monkeypatch.setattr("clothfit.formats.ply.PROPERTY_BYTES", 10**15)
    with pytest.raises(InvalidMotion, match="so many lists of different lengths take more memory than is"):
        read(MIXED)


@pytest.mark.parametrize("names", [("s", "t"), ("u", "v"), ("texture_u", "texture_v")])
def test_texture_coordinates_of_vertices(read, names):
    head = HEADER.format("ascii", 4).rstrip("\n") + "\n" + "".join(f"property float {name}\n" for name in names)
    rows = ["0 0 0 0.5 1", "1 0 0 1.5 2", "1 1 0 2.5 3", "0 1 0 3.5 4"]
    found = read(head + FACES.format(1) + "\n".join(rows) + "\n4 0 1 2 3\n")
    assert found.texture.tolist() == [[[0.5, 1], [1.5, 2], [2.5, 3]], [[0.5, 1], [2.5, 3], [3.5, 4]]]


def test_texture_coordinates_of_the_corners_of_faces(read):
    head = HEADER.format("ascii", 3) + FACES.format(2).replace(
        "end_header", "property list uchar float texcoord\nend_header"
    )
    faces = "3 0 1 2 6 0 1 2 3 4 5\n3 2 1 0 6 6 7 8 9 10 11\n"
    found = read(head + "0 0 0\n1 0 0\n1 1 0\n" + faces)
    assert found.texture.reshape(-1).tolist() == list(range(12))
    short = read(head + "0 0 0\n1 0 0\n1 1 0\n" + faces.replace("6 0 1 2 3 4 5", "0"))
    assert short.texture is None
