"""GLB files: made by hand and read, written and read by others, damaged."""

import base64
import json
import random
from dataclasses import replace
from functools import partial

import numpy as np
import pygltflib
import pytest
import trimesh
from fuzz.mutations import changed_document, with_token
from helpers import files
from helpers import scene_files as made
from helpers.scene_files import wave

from clothfit.base.errors import InvalidMotion
from clothfit.formats import glb
from clothfit.formats.axes import RIGHT
from clothfit.formats.glb import reduced
from clothfit.formats.gltf import Track

CORNERS, FACES = made.CORNERS.astype(float), made.FACES
HALF = np.sqrt(0.5)


@pytest.fixture
def read(tmp_path):
    return partial(files.read, tmp_path, "a.glb")


written = partial(files.written, "a.glb")


def split(data):
    """The document and the numbers of a file."""
    size = int.from_bytes(data[12:16], "little")
    return data[20 : 20 + size], data[28 + size :]


# By the specification a point is scaled, turned, moved, and then the same by the node above.
def test_transforms_apply_from_the_node_upwards_and_a_node_that_moves_moves_its_mesh(read):
    turn = [0, 0, HALF, HALF]  # a quarter about z
    lower = {"mesh": 0, "scale": [2, 2, 2], "rotation": turn, "translation": [1, 0, 0]}
    upper = {"children": [1], "matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 5, 1]}  # up by 5 in z
    x, y, z = 2 * CORNERS.T
    expected = np.stack([1 - y, x, z + 5], axis=1)
    found = read(made.whole(*made.parts([upper, lower])))
    np.testing.assert_allclose(found.positions[0], expected, atol=1e-15)  # the root of a half is rounded
    found = read(made.moved("translation", [0, 2], np.array([[0, 0, 0], [1, 2, 3]])))
    np.testing.assert_array_equal(found.positions, np.stack([CORNERS, CORNERS + [1, 2, 3]]))


def test_targets_are_added_by_their_weights(read):
    targets = np.random.default_rng(0).normal(size=(2, 4, 3)).astype(np.float32)
    weights = np.array([[0, 0], [0.5, -1], [1, 2]], np.float32)
    found = read(made.moved("weights", [0, 1, 3], weights.reshape(-1), targets=targets))
    np.testing.assert_array_equal(found.times, [0, 1, 3])
    expected = CORNERS + np.einsum("fk,knc->fnc", weights.astype(float), targets.astype(float))
    np.testing.assert_allclose(found.positions, expected, rtol=0, atol=1e-15)  # a sum of three, in another order


@pytest.mark.parametrize("kind", ["STEP", "CUBICSPLINE"])
def test_of_other_interpolations_the_keys_are_the_frames(read, kind):
    weights = np.array([0.0, 0.25, 1.0])
    tangents = np.array([7.0, 8.0, 9.0])
    values = weights if kind == "STEP" else np.stack([tangents, weights, -tangents], axis=1).reshape(-1)
    found = read(made.moved("weights", [0, 1, 2], values, kind, targets=[np.ones((4, 3))]))
    np.testing.assert_array_equal(found.positions, CORNERS + weights[:, None, None])
    assert "the keys are the frames" in found.notes[0]


@pytest.mark.parametrize(
    ("mode", "indices", "faces"),
    [(4, ([3, 1, 2], dtype), [[3, 1, 2]]) for dtype in ("uint8", "uint16", "uint32")]
    + [(5, None, [[0, 1, 2], [1, 3, 2]]), (6, None, [[1, 2, 0], [2, 3, 0]]), (0, None, None)],
)
def test_triangles_strips_fans_and_points(read, mode, indices, faces):
    document, numbers = made.parts(mode=mode)
    primitive = document["meshes"][0]["primitives"][0]
    del primitive["indices"]
    if indices is not None:
        primitive["indices"] = numbers.add(*indices)
    found = read(made.whole(document, numbers))
    assert (None if found.triangles is None else found.triangles.tolist()) == faces
    assert (found.times, found.axes) == (None, RIGHT)


def interleaved(document, numbers):
    rows = np.hstack([CORNERS, np.full((4, 3), 9.0)]).astype(np.float32)
    numbers.accessors[0]["bufferView"] = numbers.view(rows.tobytes(), byteStride=24)
    return CORNERS


def fractions(document, numbers):
    values = np.array([[127, -127, -128], [0, 64, 1], [1, 2, 3], [4, 5, 6]])
    position = numbers.add(values, "int8", normalized=True)
    document["meshes"][0]["primitives"][0]["attributes"]["POSITION"] = position
    document["extensionsRequired"] = ["KHR_mesh_quantization"]
    return np.maximum(values / 127, -1)


def sparse(document, numbers, based=True):
    indices, values = np.array([1, 3], np.uint16), np.array([[7, 7, 7], [8, 8, 8]], np.float32)
    numbers.accessors[0]["sparse"] = {
        "count": 2,
        "indices": {"bufferView": numbers.view(indices.tobytes()), "componentType": 5123},
        "values": {"bufferView": numbers.view(values.tobytes())},
    }
    if not based:
        del numbers.accessors[0]["bufferView"]
    expected = CORNERS * based
    expected[indices] = values
    return expected


@pytest.mark.parametrize("stored", [interleaved, fractions, sparse, partial(sparse, based=False)])
@pytest.mark.parametrize("within", [False, True])
def test_numbers_are_read_however_they_are_stored_in_a_chunk_or_within_the_document(read, stored, within):
    document, numbers = made.parts()
    expected = stored(document, numbers)
    uri = "data:application/octet-stream;base64," + base64.b64encode(numbers.data).decode()
    inside = {**document, "buffers": [{"byteLength": len(numbers.data), "uri": uri}]}
    found = read(made.container(inside) if within else made.whole(document, numbers))
    np.testing.assert_array_equal(found.positions[0], expected)


def test_primitives_follow_each_other_and_share_their_vertices(read):
    document, numbers = made.parts()
    first = document["meshes"][0]["primitives"][0]
    other = {"attributes": {"POSITION": numbers.add(CORNERS + 1)}, "indices": first["indices"]}
    document["meshes"][0]["primitives"] += [{**first, "material": 1}, other]
    found = read(made.whole(document, numbers))
    np.testing.assert_array_equal(found.positions[0], np.concatenate([CORNERS, CORNERS + 1]))
    np.testing.assert_array_equal(found.triangles, np.concatenate([FACES, FACES, FACES + 4]))


def test_meshes_that_keep_their_shape_are_left_out_beside_one_that_does_not(read):
    data = made.moved("weights", [0, 1], [0, 1], nodes=[{"mesh": 0}, {"mesh": 1}], targets=[CORNERS])
    text, numbers = split(data)
    document = json.loads(text)
    document["scenes"] = [{"nodes": [1, 0]}]
    document["meshes"].append({"primitives": [{"attributes": {"POSITION": 0}}]})
    found = read(made.container(document, numbers))
    np.testing.assert_array_equal(found.positions, [CORNERS, 2 * CORNERS])
    assert "1 mesh keeps its shape and is left out" in found.notes[0]


def test_round_trip_to_the_tolerance_that_is_told(read):
    motion = wave()
    data = written(motion)
    found = read(data)
    largest = np.linalg.norm(found.positions - motion.positions, axis=2).max()
    extras = json.loads(split(data)[0])["meshes"][0]["extras"]
    assert largest <= glb.LARGEST_ERROR
    assert extras["largestError"] == pytest.approx(largest, rel=1e-6)  # the same numbers, added in another order
    assert extras["targets"] == len(extras["targetNames"])
    np.testing.assert_array_equal(found.triangles, motion.triangles)
    np.testing.assert_allclose(found.times, motion.times, rtol=6e-8)  # float32


@pytest.mark.parametrize("frames", [1, 2])
def test_short_and_still_motions(read, frames, tmp_path):
    motion = wave(frames)
    still = replace(motion, positions=np.repeat(motion.positions[:1], frames, axis=0))
    data = written(still)
    found = read(data)
    np.testing.assert_array_equal(found.positions, still.positions.astype(np.float32))
    np.testing.assert_array_equal(found.triangles, motion.triangles)
    assert read(written(replace(still, triangles=None))).triangles is None
    if frames == 1:  # what trimesh reads and writes
        (tmp_path / "b.glb").write_bytes(data)
        mesh = trimesh.load(tmp_path / "b.glb", process=False).to_mesh()
        np.testing.assert_array_equal(mesh.vertices, found.positions[0])
        np.testing.assert_array_equal(mesh.faces, motion.triangles)
        box = trimesh.creation.box((1, 2, 3))
        found = read(box.export(file_type="glb"))
        np.testing.assert_array_equal(found.positions[0], box.vertices)
        np.testing.assert_array_equal(found.triangles, box.faces)
        return
    early = read(written(replace(motion, times=motion.times - 1)))  # glTF has no times before 0
    np.testing.assert_allclose(early.times, motion.times, atol=1e-7)  # float32 of numbers up to 1


# What pygltflib finds is put together by hand, as the specification has it.
def test_pygltflib_finds_base_targets_and_weights(tmp_path):
    motion = wave()
    path = tmp_path / "a.glb"
    path.write_bytes(written(motion))
    other = pygltflib.GLTF2().load(str(path))

    def array(index, width):
        described = other.accessors[index]
        view = other.bufferViews[described.bufferView]
        start = view.byteOffset + (described.byteOffset or 0)
        values = np.frombuffer(other.binary_blob(), np.float32, described.count * width, start)
        return values.astype(float).reshape(-1, width)

    mesh, animation = other.meshes[other.nodes[0].mesh], other.animations[0]
    primitive, sampler = mesh.primitives[0], animation.samplers[0]
    targets = np.stack([array(each["POSITION"], 3) for each in primitive.targets])
    weights = array(sampler.output, 1).reshape(-1, len(targets))
    positions = array(primitive.attributes.POSITION, 3) + np.einsum("fk,knc->fnc", weights, targets)
    assert animation.channels[0].target.path == "weights"
    assert 0 <= weights.min() <= weights.max() <= 1  # Blender and Unity clamp others
    np.testing.assert_array_equal(np.float32(mesh.weights), weights[0])  # the first frame, where nothing plays
    assert np.linalg.norm(positions - motion.positions, axis=2).max() <= glb.LARGEST_ERROR
    np.testing.assert_allclose(array(sampler.input, 1)[:, 0], motion.times, rtol=6e-8)


# A file of some hundred bytes that promises the memory of a building, and one array that is named many times.
@pytest.mark.parametrize("count", [2**31, 2**39, 4])
@pytest.mark.parametrize("viewless", [False, True])
def test_counts_are_held_against_the_file_and_the_memory(read, monkeypatch, count, viewless):
    copies = 800 if count == 4 else 1
    monkeypatch.setattr("clothfit.base.memory.missing", lambda needed: 10**5 if needed > 10**5 else None)
    document, numbers = made.parts([{"mesh": 0}] * copies)
    document["scenes"] = [{"nodes": list(range(copies))}]
    numbers.accessors[0]["count"] = count
    if viewless:
        del numbers.accessors[0]["bufferView"]
    with pytest.raises(InvalidMotion, match=r"a\.glb: .*keep fewer frames" if count == 4 else r"a\.glb: "):
        read(made.whole(document, numbers))


# Other damage: test_every_format.
def test_damaged_documents_are_refused_or_read_and_nothing_else(read):
    chance = random.Random(0)
    nodes = [{"children": [1]}, {"mesh": 0, "scale": [1, 2, 3]}]
    turning = made.moved("rotation", [0, 1], np.ones((2, 4)), nodes=nodes)
    goods, refused = [split(written(wave(6, count=8))), split(turning)], 0
    for i in range(400):
        text, numbers = goods[i % 2]
        other = with_token(chance, text)
        if chance.randrange(2):
            other = json.dumps(changed_document(chance, partial(json.loads, text))).encode()
        try:
            assert np.isfinite(read(made.container(other, numbers)).positions).all()
        except InvalidMotion:
            refused += 1
    assert refused > 150  # so that damage was done


@pytest.mark.parametrize("mirror", [1, -1])
def test_texture_coordinates_nodes_and_materials(read, mirror):
    """The second of two nodes has no texture; a node that mirrors its mesh turns the corners with their texture."""
    document, numbers = made.parts([{"mesh": 0, "name": "left", "scale": [mirror, 1, 1]}, {"mesh": 1, "name": "right"}])
    first = document["meshes"][0]["primitives"][0]
    uv = numbers.add(CORNERS[:, :2])
    document["materials"] = [{"name": "cotton"}, {}]
    document["meshes"] = [
        {"primitives": [{**first, "attributes": {**first["attributes"], "TEXCOORD_0": uv}, "material": 0}]},
        {"primitives": [{**first, "material": 1}]},
    ]
    document["scenes"][0]["nodes"] = [0, 1]
    found = read(made.whole(document, numbers))
    count = len(FACES)
    np.testing.assert_array_equal(found.triangles[:count], FACES if mirror == 1 else FACES[:, ::-1])
    assert found.texture[:count] == pytest.approx(found.positions[0][found.triangles[:count], :2] * [mirror, 1])
    assert np.isnan(found.texture[count:]).all()
    left, right = list(range(len(CORNERS))), list(range(len(CORNERS), 2 * len(CORNERS)))
    assert [(name, own.tolist()) for name, own in found.parts] == [("left", left), ("right", right), ("cotton", left)]


@pytest.mark.parametrize("index", [0, 99, "x", None])
def test_texture_coordinates_that_cannot_be_are_left_out(read, index):
    document, numbers = made.parts()
    document["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_0"] = index
    found = read(made.whole(document, numbers))
    assert (found.texture, len(found.triangles)) == (None, len(FACES))


# Motions on few shapes: their number, their error.


# Displacements from the first frame of a motion of rank 3 have rank 3 at most; the rest is rounding to float32, whose
# relative error is 6e-8, of numbers up to about 5 that are added. One that goes one way keeps its first frame as base.
def test_a_motion_of_few_shapes_takes_few_targets():
    morphs = reduced(wave(rank=3).positions, 1e-5)
    assert len(morphs.targets) == 3
    assert morphs.error < 2e-6
    first, way = np.random.default_rng(2).normal(size=(2, 9, 3))
    for sign in (1, -1):
        morphs = reduced(first + sign * np.linspace(0, 1, 12)[:, None, None] * way, 1e-5)
        assert len(morphs.targets) == 1
        np.testing.assert_allclose(morphs.base, first, atol=1e-6)  # float32 of numbers up to 3
        np.testing.assert_allclose(morphs.targets[0], sign * way, atol=1e-6)


# Frames of more and more different sizes, or coordinates; of frames there are fewer than coordinates, or more.
@pytest.mark.parametrize("tolerance", [1e-2, 1e-4, 1e-5])
@pytest.mark.parametrize("shape", [(20, 9, 3), (60, 9, 3)])
def test_the_largest_error_is_below_the_tolerance_and_one_target_less_is_not_enough(shape, tolerance):
    positions = np.random.default_rng(0).normal(size=shape) * np.geomspace(1, 1e-6, shape[0])[:, None, None]
    morphs = reduced(positions, tolerance)
    assert morphs.error <= tolerance
    weights, targets = morphs.weights.astype(float), morphs.targets.astype(float)
    without = weights - np.append(np.zeros(weights.shape[1] - 1), 1) * (weights - weights[0])  # the last one at rest
    fewer = np.einsum("fk,knc->fnc", without, targets)
    assert np.linalg.norm(fewer + morphs.base - positions, axis=2).max() > tolerance


# Viewers clamp weights to 0 … 1. The sum is one of float32 numbers up to about 10, with a relative error of 6e-8 each.
@pytest.mark.parametrize("shape", [(1, 5, 3), (2, 5, 3), (30, 9, 3), (60, 9, 3)])
def test_weights_within_0_and_1_give_the_motion_and_use_all_of_it(shape):
    positions = np.random.default_rng(1).normal(size=shape)
    morphs = reduced(positions, 1e-5)
    assert 0 <= morphs.weights.min() <= morphs.weights.max() <= 1
    whole = morphs.base + np.einsum("fk,knc->fnc", morphs.weights.astype(float), morphs.targets.astype(float))
    assert np.linalg.norm(whole - positions, axis=2).max() == pytest.approx(morphs.error, abs=1e-12)
    assert morphs.error < 1e-5
    if shape[0] > 1:
        np.testing.assert_array_equal(morphs.weights.min(axis=0), 0)
        np.testing.assert_array_equal(morphs.weights.max(axis=0), 1)


# Values between keys: closed forms.


# A cubic is given by its values and slopes at both ends.
def test_a_spline_is_the_cubic_with_its_values_and_tangents():
    times = np.array([0.0, 2.0, 3.0])
    value, slope = times**3 - times, 3 * times**2 - 1
    into, out = [9.0, *slope[1:]], [*slope[:-1], 9.0]  # before the first key and after the last they do not count
    track = Track(times, np.stack([into, value, out], axis=1)[..., None], "CUBICSPLINE")
    t = np.linspace(0, 3, 13)
    np.testing.assert_allclose(track.at(t)[:, 0], t**3 - t, atol=1e-14)  # values up to 24, a few roundings
    line = Track(np.array([1.0, 2.0]), np.array([[3.0], [5.0]]), "LINEAR")  # values stay before and after the keys
    np.testing.assert_array_equal(line.at(np.array([0, 1, 1.5, 2, 9]))[:, 0], [3, 3, 4, 5, 5])


def test_rotations_turn_evenly_and_the_shorter_way():
    ends = np.array([[0, 0, 0, 1], [0, 0, -HALF, -HALF]])  # a quarter about z, with the other sign
    angles = np.linspace(0, np.pi / 2, 5)
    turned = Track(np.array([0.0, 1.0]), ends, "LINEAR").at(np.linspace(0, 1, 5), rotation=True)
    turned *= np.sign(turned[:, 3:])  # of either sign it is the same rotation
    np.testing.assert_allclose(turned[:, 2], np.sin(angles / 2), atol=1e-15)
    np.testing.assert_allclose(turned[:, 3], np.cos(angles / 2), atol=1e-15)
