"""Paths of pins in glTF and USD: at the end of each step they are where the scene has its pins."""

import numpy as np
import pygltflib
import pytest
from helpers.scenes import cloth, document, write_scene
from scipy.spatial.transform import Rotation

from clothfit.cli.program import run
from clothfit.engine.inputs.sampling import paths
from clothfit.export.tools import exported
from clothfit.scene.scene import load

PINS = {"object0_pin0": [0, 1], "object0_pin1": [2], "object0_pin2": [3, 4], "object0_pin3": [5, 6, 7]}
MIRROR = np.array([-1.0, 1.0, 1.0])


def keys(times, *values, **more):
    """Keys of a scene."""
    return {"times": times, "values": [dict(zip("xyz", each, strict=True)) for each in values], **more}


def text():
    """A scene with pins of all kinds: linear, smooth, held, turning; keys before the start and after the end."""
    one = cloth(5, 5, vertIsFixed=[True] * 12 + [False] * 13)
    held = keys([-0.2, 0.4, 0.9], (0, 0, 0), (0, 0.7, 0), (1, 0, 0), interpolation="hold")
    smooth = keys([0.1, 0.5, 0.77, 1.5], (1, 0, 0), (0, 1, 0.2), (0.3, -1, 0), (0, 0, 1), interpolation="smooth")
    one["pins"] = [
        {"vertices": [0, 1], "posKeys": keys([0.11, 0.31, 1.1], (0, 0, 0), (0.5, 0.2, -0.3), (1, 0, 0.7))},
        {"vertices": [2], "posKeys": smooth},
        {"vertices": [3, 4], "posKeys": held},
        {"vertices": [5, 6, 7], "posKeys": keys([0, 3], (0, 0, 0), (0.4, 0, 0)),
         "rotKeys": keys([0, 0.6, 1.2], (0, 0, 0), (0, 170, 20), (30, 300, 0))},
    ]  # fmt: skip
    return document(one, delta=0.02, optimizationIterations=61)


@pytest.fixture(scope="module")
def scene():
    return load(text())


@pytest.fixture(scope="module")
def truth(scene):
    """Times (T,), s, and of each vertex its path (T, 3) in right-handed axes, m."""
    times = scene.delta * np.arange(scene.frames)
    vertices, places = paths(scene.cloths[0], times)
    return times, dict(zip(vertices.tolist(), np.moveaxis(places * MIRROR, 1, 0), strict=True))


def offset(scene, name, vertex):
    """Where a vertex is from the mean of its pin, at the start."""
    x = scene.cloths[0].positions * MIRROR
    return x[vertex] - x[PINS[name]].mean(axis=0)


class Player:
    """Plays a GLB file by the rules of its specification; its parts are read by pygltflib."""

    def __init__(self, data):
        self.doc = pygltflib.GLTF2.load_from_bytes(data)
        (animation,) = self.doc.animations
        self.tracks = {}
        for channel in animation.channels:
            own, name = animation.samplers[channel.sampler], self.doc.nodes[channel.target.node].name
            track = (*map(self.array, (own.input, own.output)), own.interpolation)
            self.tracks[name, channel.target.path] = track

    def array(self, index):
        """The numbers of an accessor."""
        accessor, width = self.doc.accessors[index], {"SCALAR": (), "VEC3": (3,), "VEC4": (4,)}
        shape = (accessor.count, *width[accessor.type])
        start = self.doc.bufferViews[accessor.bufferView].byteOffset
        return np.frombuffer(self.doc.binary_blob(), "<f4", int(np.prod(shape)), start).astype(float).reshape(shape)

    def at(self, name, path, time):
        """The value of a track at a time."""
        times, values, way = self.tracks[name, path]
        inside = min(max(time, times[0]), times[-1])
        before = max(int(np.searchsorted(times, inside, side="right")) - 1, 0)
        after = min(before + 1, len(times) - 1)
        share = 0.0 if after == before or way == "STEP" else (inside - times[before]) / (times[after] - times[before])
        found = values[before] + share * (values[after] - values[before])  # of turns, too: steps are short
        return Rotation.from_quat(found).as_matrix() if path == "rotation" else found


def test_a_gltf_player_moves_the_pins_as_the_scene_does(scene, truth):
    (data,) = exported(scene, "gltf").values()
    player, (times, ways) = Player(data), truth
    assert {node.name: node.extras["vertices"] for node in player.doc.nodes} == PINS
    for name, vertices in PINS.items():
        for vertex in vertices:
            own = offset(scene, name, vertex)
            for k, time in enumerate(times):
                turn = player.at(name, "rotation", time) if (name, "rotation") in player.tracks else np.eye(3)
                place = player.at(name, "translation", time) + turn @ own
                np.testing.assert_allclose(place, ways[vertex][k], atol=1e-6)  # of float32, in m
    times, _, way = player.tracks["object0_pin0", "translation"]
    np.testing.assert_allclose(times, [0, 0.11, 0.31, 1.1, 1.2], rtol=1e-7)  # linear keys stay the keys they were
    assert way == "LINEAR"
    assert player.tracks["object0_pin2", "translation"][2] == "STEP"
    assert len(player.tracks["object0_pin1", "translation"][0]) == scene.frames


def test_usd_moves_the_pins_as_the_scene_does(scene, truth, tmp_path):
    pxr = pytest.importorskip("pxr.Usd", reason="usd-core is not installed")
    from pxr import Gf, UsdGeom

    path = tmp_path / "h.usda"
    path.write_bytes(exported(scene, "usd")["handles.usda"])
    stage, (times, ways) = pxr.Stage.Open(str(path)), truth
    assert stage.GetEndTimeCode() == scene.frames - 1
    for name, vertices in PINS.items():
        prim = stage.GetPrimAtPath(f"/handles/{name}")
        assert prim.GetCustomDataByKey("vertices") == " ".join(map(str, vertices))
        for k, time in enumerate(times):
            matrix = UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(time * stage.GetTimeCodesPerSecond())
            for vertex in vertices:
                found = matrix.Transform(Gf.Vec3d(*offset(scene, name, vertex).tolist()))
                np.testing.assert_allclose(found, ways[vertex][k], atol=1e-12)


def test_vertices_that_go_their_own_ways_have_a_node_each(tmp_path):
    path = np.cumsum(np.random.default_rng(2).normal(size=(4, 2, 3)), axis=0)
    np.savez(tmp_path / "m.npz", positions=path, times=0.1 * np.arange(4))
    made = text()
    made["objects"][0]["pins"] = [{"vertices": [2, 7], "posKeys": {"file": str(tmp_path / "m.npz"), "points": [0, 1]}}]
    scene = load(made)
    player = Player(exported(scene, "gltf")["handles.glb"])
    assert [node.name for node in player.doc.nodes] == ["object0_pin0_2", "object0_pin0_7"]
    _, places = paths(scene.cloths[0], np.array([0.25]))
    for j, node in enumerate(player.doc.nodes):
        np.testing.assert_allclose(player.at(node.name, "translation", 0.25), places[0, j] * MIRROR, atol=1e-5)


def test_the_command_writes_them_and_a_scene_without_pins_is_refused(folder, capsys):
    write_scene(folder, text(), "a.json")
    assert run(["export", "a.json", "--to", "gltf"]) == 0
    assert "a-gltf: handles.glb" in capsys.readouterr().err
    assert (folder / "a-gltf" / "handles.glb").read_bytes()[:4] == b"glTF"
    for tool in ("gltf", "usd"):
        assert run(["export", "scene.json", "--to", tool]) == 3
        assert "has no pins; only their paths are exported" in capsys.readouterr().err
        assert not (folder / f"scene-{tool}").exists()
