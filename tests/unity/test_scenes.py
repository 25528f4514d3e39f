"""What the Unity package writes and reads: against real files of the editor, and against this program."""

import json
import struct
import subprocess
import sys

import numpy as np
import pytest
from helpers import networks
from helpers.files import leaves
from helpers.paths import EXAMPLES, SIDE

from clothfit import load
from clothfit.cli.program import run
from clothfit.engine.system import build
from clothfit.subspace.frames import Decoder
from clothfit.subspace.model import save
from clothfit.subspace.network.signals import raw
from clothfit.subspace.play import play

pytestmark = pytest.mark.slow  # starts a compiler and processes

real = pytest.mark.skipif(not SIDE.is_file(), reason="the reference scene is not beside the checkout")


def read(path):
    return json.loads(path.read_text("utf-8"))


# --- the stand-in itself


def test_the_stand_in_serialises_by_the_rules_of_unity(harness):
    first, second, listed, refused = harness("json")
    text = '"text":"a\\"\\\\\\n\\u0001é"'
    assert first == '{"v":0.0,"none":[],"absent":{"v":0.0},' + text + ',"choice":2,"hidden":true}'
    assert second == '{"v":0.0,"none":[{"v":2.0},{"v":0.0}],"absent":{"v":0.0},"text":"b","choice":2,"hidden":true}'
    assert (listed, refused) == ("{}", "JSON must represent an object type.")


def test_printed_numbers_are_the_float32_values(harness):
    bits = np.random.default_rng(0).integers(0, 2**32, 3000, dtype=np.uint64)
    values = [struct.unpack("<f", struct.pack("<I", each))[0] for each in bits.tolist()]
    finite = [(each, value) for each, value in zip(bits, values, strict=True) if np.isfinite(value)]
    lines = harness("number", input="".join(f"{each}\n" for each, _ in finite))
    assert [json.loads(line)["v"] for line in lines] == [value for _, value in finite]


@real
def test_a_real_file_comes_back_to_the_byte(harness, tmp_path):
    harness("copy", SIDE, tmp_path / "side.txt")
    assert (tmp_path / "side.txt").read_bytes() == SIDE.read_bytes()


# --- scenes from components


@real
def test_components_give_the_scene_that_the_editor_gave(harness, tmp_path):
    harness("scene", "side", tmp_path / "side.txt")
    theirs, ours = json.loads(SIDE.read_text("utf-8")), read(tmp_path / "side.txt")
    assert list(ours) == list(theirs)
    for name in set(theirs) - {"objects"}:
        assert ours[name] == theirs[name]
    for mine, other in zip(ours["objects"], theirs["objects"], strict=True):
        assert list(mine) == list(other)
        for name in ("vertIsFixed", "springs", "triangles", "dragCoefficient", "damping", "optimizationSettings"):
            assert mine[name] == other[name]
        for name in ("vertMass", "springStiffness"):  # the editor adds up in float32: a few roundings of 6e-8
            np.testing.assert_allclose(mine[name], other[name], rtol=5e-7)
        places = [[[p["x"], p["y"], p["z"]] for p in each["vertPos"]] for each in (mine, other)]
        np.testing.assert_allclose(*places, rtol=5e-7)


def test_all_that_the_package_writes_is_valid_and_read_back(harness, tmp_path):
    path, again = tmp_path / "everything.json", tmp_path / "again.json"
    harness("scene", "everything", path)
    scene = load(str(path))
    names = {block.name for block in scene.blocks}
    assert names == {"mass", "stiffness", "damping", "drag", "velocity", "rest", "path", "shift", "wind", "gravity",
                     "gusts", "friction", "contact", "offset"}  # fmt: skip
    document = read(path)
    assert document["fit"]["bounds"] == {"wind": [-20, 20]}
    assert document["objects"][0]["fit"]["bounds"] == {"stiffness": [1, 500], "path": [-1, 1]}
    assert [each["type"] for each in document["colliders"]] == [1, 2, 3, 0]
    harness("copy", path, again)
    assert again.read_bytes() == path.read_bytes()


@pytest.mark.parametrize("name", ["side.json", "flag.json", "drape.json", "world/flag.json", "world/curtain.json"])
def test_scenes_of_others_come_back_with_all_numbers(harness, tmp_path, name):
    harness("copy", EXAMPLES / name, tmp_path / "copy.json")
    assert leaves(read(tmp_path / "copy.json")) == leaves(read(EXAMPLES / name))


def test_vertices_in_one_place_are_one_vertex(harness, tmp_path):
    harness("scene", "seam", tmp_path / "seam.json")
    cloth = read(tmp_path / "seam.json")["objects"][0]
    places = [(p["x"], p["z"]) for p in cloth["vertPos"]]
    assert places == [(-1, 0), (-1, 1), (0, 0), (0, 1), (1, 0), (1, 1)]
    assert cloth["triangles"] == [0, 1, 2, 1, 3, 2, 2, 3, 4, 3, 5, 4]
    assert load(str(tmp_path / "seam.json")).cloths[0].springs.shape == (12, 2)  # 9 edges, 3 of them shared


def test_every_fitted_value_comes_back_and_nothing_else_changes(harness, tmp_path):
    """The values of a fit are made up here, so that each is another than before."""
    path, fitted, again = (tmp_path / name for name in ("scene.json", "fitted.json", "again.json"))
    harness("scene", "everything", path)
    document = read(path)
    cloth, scale = document["objects"][0], 1.25
    for name in ("vertMass", "springStiffness"):
        cloth[name] = [scale * each for each in cloth[name]]
    cloth |= {"damping": 0.3, "dragCoefficient": 0.7, "springRestLength": [0.5] * len(cloth["springStiffness"])}
    cloth["vertVel"] = [{"x": 0.1, "y": 0.2, "z": 0.3}] * len(cloth["vertPos"])
    cloth["pinOffset"] = {"x": 0.1, "y": 0, "z": 0}
    cloth["pins"][0]["posKeys"]["values"][1] = {"x": 0.3, "y": 0.2, "z": 0.1}
    document |= {"windVel": {"x": 3, "y": 0, "z": 1}, "gravity": {"x": 0, "y": -9.5, "z": 0}}
    document |= {"colliderOffset": {"x": 0, "y": 0.5, "z": 0}}
    document["windVelKeys"]["values"][1]["x"] = 5
    for k, each in enumerate([*document["colliders"], document["selfCollision"]]):
        each |= {"friction": 0.4, "stiffness": 500 + k}
    fitted.write_text(json.dumps(document), "utf-8")
    harness("import", "everything", fitted, again)
    before, wanted, found = (leaves(read(each)) for each in (path, fitted, again))
    assert found == wanted
    assert len([name for name in before if before[name] != wanted[name]]) > 300


def test_a_file_of_another_scene_is_refused(harness, tmp_path):
    harness("scene", "trial", tmp_path / "trial.json")
    call = ["mono", str(harness.path), "import", "side", tmp_path / "trial.json", tmp_path / "no.json"]
    done = subprocess.run(call, capture_output=True, check=False)
    assert b"the file has 20 masses, the scene has 144; was the scene changed after the export?" in done.stderr
    assert not (tmp_path / "no.json").exists()


# --- motions


def test_a_motion_of_the_program_is_read_and_played_and_a_broken_one_refused(harness, tmp_path):
    scene, motion, kept = tmp_path / "trial.json", tmp_path / "motion.pc2", tmp_path / "motion.npz"
    harness("scene", "trial", scene)
    for path in (motion, kept):
        assert run(["simulate", str(scene), "-o", str(path), "-q"]) == 0
    truth = np.load(kept)["positions"]
    size, *lines = harness("motion", motion, 7, truth.shape[1])
    assert size == f"{len(truth)} {truth.shape[1]}"
    np.testing.assert_array_equal(np.array([line.split() for line in lines], np.float32), truth[7].astype(np.float32))
    shown = harness("play", "trial", motion)
    assert [line for line in shown if "error" in line] == ["20 no error", "16 no error"]
    places = np.array([line.split() for line in shown if "error" not in line], float)
    np.testing.assert_allclose(places, truth[7], atol=1e-6)  # float32, into the mesh's axes and back
    motion.write_bytes(b"POINTCACHE2\0" + struct.pack("<iiffi", 1, 41, 0, 1, 20) + b"\0" * 100)
    shown = harness("play", "trial", motion)
    assert shown[-1].endswith("motion.pc2: the file is shorter than its header says")
    assert len(shown) == 20 + 1 + 16 + 1  # the meshes stay as they are


@pytest.mark.parametrize("wrong", [False, True])
def test_a_network_plays_on_a_mesh(harness, tmp_path, wrong):
    harness("scene", "gusts", tmp_path / "gusts.json")
    scene, steps = load(str(tmp_path / "gusts.json")), 30
    model = networks.model_of(scene, steps, 5)
    save(model, tmp_path / "m.npz")
    signals = np.concatenate([table for _, table in raw(build(scene, 0, steps=steps), steps)], axis=1)[:, wrong:]
    lines = "".join(" ".join(map(repr, each.tolist())) + "\n" for each in signals)
    error, *numbers = harness("subspace", "gusts", tmp_path / "m.npz", steps, input=lines)
    size = len(scene.cloths[0].positions)
    places, normals = np.array([line.split() for line in numbers], float).reshape(2, size, 3)
    if wrong:
        assert error == f"a step takes {signals.shape[1] + 1} numbers, not {signals.shape[1]}"
        truth = scene.cloths[0].positions
    else:
        assert error == "no error"
        truth = play(model, scene, steps + 1).motion.positions[-1]
        own = Decoder(truth, model.parts[0].basis, scene.cloths[0].triangles)
        np.testing.assert_allclose(normals, own.normals(np.float32(truth[None]))[0], atol=1e-4)  # float32
    np.testing.assert_allclose(places, truth, atol=1e-5)  # float32, summed in another order


# --- arguments of a process


def test_arguments_arrive_as_they_are_and_are_quoted_for_windows_as_python_does_it(harness):
    odd = ["a b", "ü 窗", "c:\\folder\\", "\\\\", 'say "no"', "$HOME `x`", "", "it's", "*.json", "a\\\"b", "%PATH%"]
    show = "import sys, json; print(json.dumps(sys.argv[1:]))"
    assert json.loads(harness("echo", sys.executable, "-c", show, *odd)[0]) == odd
    odd = ["a b", "c d\\", "e f\\\\", 'say "no" now', 'x \\"y', "\\ \\\\ z", ""]
    assert harness("quote", *odd) == [subprocess.list2cmdline([each]) for each in odd]
