"""Models in other programs: graphs in ONNX Runtime, and the C# player, compiled by Mono, beside `subspace play`."""

import dataclasses
import shutil
import subprocess
import sys

import numpy as np
import pytest
from helpers import networks, subspaces
from helpers.paths import ROOT
from helpers.scenes import cloth, document
from helpers.subspaces import keys, scene_of

from clothfit.cli.program import run
from clothfit.engine.system import build
from clothfit.subspace import onnx
from clothfit.subspace.frames import Decoder
from clothfit.subspace.model import load_model, save
from clothfit.subspace.network.signals import raw
from clothfit.subspace.play import play, ready

pytestmark = pytest.mark.slow  # compiles motions with inputs, and starts processes

STEPS, SIZE = 1000, 8
CLOSE = 1e-5
"""Of the motion: `play` has single precision and the players double, so that what is left is its rounding."""

PLAYER = ROOT / "examples" / "clients" / "Subspace.cs"
MOST_LINES = 200

PROGRAM = """
using System;
using System.IO;
static class Program
{
    static float[] Floats(string path)
    {
        byte[] data = File.ReadAllBytes(path);
        var found = new float[data.Length / 4];
        Buffer.BlockCopy(data, 0, found, 0, data.Length);
        return found;
    }

    static void Main(string[] given)
    {
        var cloth = new Clothfit.Subspace(given[0]);
        float[] raw = Floats(given[1]), pins = Floats(given[2]), q = given[4] == "-" ? null : Floats(given[4]);
        int steps = int.Parse(given[5]);
        using (var file = new BinaryWriter(File.Create(given[3])))
            for (int t = 0; t <= steps; t++)
            {
                var acts = new float[cloth.Raw];
                if (t > 0 && q == null)
                {
                    Array.Copy(raw, (t - 1) * cloth.Raw, acts, 0, cloth.Raw);
                    cloth.Step(acts);
                }
                for (int i = 0; i < cloth.Size && q != null; i++) cloth.Coordinates[i] = q[t * cloth.Size + i];
                var now = new float[3 * cloth.Pins];
                Array.Copy(pins, t * now.Length, now, 0, now.Length);
                cloth.Decode(cloth.Pins > 0 ? now : null);
                cloth.Shade();
                foreach (float x in cloth.Positions) file.Write(x);
                foreach (float x in cloth.Normals) file.Write(x);
            }
    }
}
"""


@pytest.fixture(scope="module")
def scene():
    """A cloth with wind and a pin that move for 1,000 steps."""
    times = np.linspace(0.0, 21.0, 43).tolist()
    rng = np.random.default_rng(2)
    gusts, ways = rng.uniform(-4, 4, (43, 3)), 0.2 * rng.uniform(-1, 1, (43, 3))
    ways[0] = 0.0
    own = cloth(4, 3, pins=[{"vertices": [0], "posKeys": keys(times, *ways)}], damping=0.4)
    return scene_of(document(own, windVelKeys=keys(times, *gusts)))


@pytest.fixture(scope="module", params=["relu", "elu"])
def model(request, scene):
    """A network with random weights that swings for 1,000 steps, with a regression of normals."""
    made = networks.model_of(scene, STEPS, SIZE, activation=request.param)
    rng = np.random.default_rng(4)
    (part,) = made.parts
    linear = part.network.linear.copy()
    linear[: 2 * SIZE] = np.concatenate([0.998 * np.eye(SIZE), 0.97 * np.eye(SIZE)])  # it forgets within 70 steps
    linear[2 * SIZE :] *= 0.05
    weights = (*part.network.weights[:-1], 0.01 * part.network.weights[-1])
    biases = (*part.network.biases[:-1], 0.01 * part.network.biases[-1])
    limits = np.float32([np.full(SIZE, -20.0), np.full(SIZE, 20.0)])
    network = dataclasses.replace(part.network, linear=linear, weights=weights, biases=biases, range=limits)
    part = dataclasses.replace(part, network=network)
    normals = rng.standard_normal((len(part.basis), 3, 1 + SIZE)).astype(np.float32)
    return dataclasses.replace(made, parts=(dataclasses.replace(part, normals=normals),))


def pins_of(scene, steps):
    """The ways (steps + 1, P, 3) of the pins."""
    path = build(scene, 0, steps=steps).inputs.path
    return np.float32(path[: steps + 1] - path[0])


def off(x, true):
    """The RMS error of a motion, relative to the RMS of its displacements."""
    return np.sqrt(((x - true) ** 2).mean() / ((true - true[0]) ** 2).mean())


def session(data):
    """A session of ONNX Runtime, which checks the graph; the test is skipped where that is not installed."""
    runtime = pytest.importorskip("onnxruntime", reason="onnxruntime is not installed")
    return runtime.InferenceSession(data, providers=["CPUExecutionProvider"])


def test_graphs_give_the_motion_of_the_model(scene, model):
    checker = pytest.importorskip("onnx.checker", reason="onnx is not installed")
    files = onnx.files(model)
    assert set(files) == {"step.onnx", "decode.onnx"}
    for data in files.values():
        checker.check_model(data, full_check=True)  # onnx itself finds nothing wrong
    step, decode = session(files["step.onnx"]), session(files["decode.onnx"])
    played = play(model, scene, STEPS + 1)
    own = ready(model, model.parts[0], scene, 0, STEPS, {})
    q, before = np.zeros((2, SIZE)), np.tile(own.before.astype(float), (2, 1))
    q[1] = 0.1  # another instance, which forgets where it began, as a row of the same graph
    found = [q[:1]]
    for t in range(STEPS):
        (new,) = step.run(["q"], {"q1": q, "q2": before, "w": own.w[[t, t]]})
        q, before = new, q
        found.append(q[:1])
        assert t > 0 or np.abs(q[1] - q[0]).max() > 1e-3
    np.testing.assert_allclose(q[1], q[0], atol=1e-5)
    assert np.abs(np.diff(played.coordinates[0][-100:], axis=0)).max() > 1e-3  # it still moves
    assert off(np.concatenate(found), played.coordinates[0]) < CLOSE
    given = {"q": np.concatenate(found), "pins": pins_of(scene, STEPS)}
    x, normals = decode.run(["positions", "normals"], given)  # all frames at once
    assert off(x, played.motion.positions) < CLOSE
    np.testing.assert_allclose(np.linalg.norm(normals, axis=2), 1.0, atol=1e-5)


def test_physics_has_a_decoder_and_says_so(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    still = scene_of(document(cloth(5, 4)))
    own = subspaces.model_of(still, 6)
    own = dataclasses.replace(own, parts=(dataclasses.replace(own.parts[0], half=True),))
    save(own, tmp_path / "m.npz")
    with monkeypatch.context() as patch:
        patch.setitem(sys.modules, "onnx", None)  # as if it were not installed
        assert run(["export", "m.npz", "--to", "onnx"]) == 3
    assert "pip install 'clothfit[onnx]'" in capsys.readouterr().err
    pytest.importorskip("onnx", reason="onnx is not installed")
    assert run(["export", "m.npz", "--to", "onnx"]) == 0
    assert "its steps are physics, which is no graph" in capsys.readouterr().err
    assert [each.name for each in (tmp_path / "m-onnx").iterdir()] == ["decode.onnx"]
    assert run(["export", "m.npz", "--to", "csv"]) == 3
    read = load_model(tmp_path / "m.npz")
    assert read.parts[0].half
    q = np.random.default_rng(0).standard_normal((3, 6))
    (x,) = session((tmp_path / "m-onnx" / "decode.onnx").read_bytes()).run(["positions"], {"q": q})
    expected = still.cloths[0].positions + np.einsum("nir,fr->fni", read.parts[0].basis, q)
    np.testing.assert_allclose(x, expected, atol=1e-5)


def test_the_player_in_csharp_is_short_and_without_packages():
    lines = PLAYER.read_text("utf-8").splitlines()
    assert len(lines) <= MOST_LINES
    assert [line for line in lines if line.startswith("using ") and "System" not in line] == []


def by_mono(folder, model_path, acts, pins, steps, q=None):
    """What the player in C# makes of a model: positions and normals (steps + 1, n, 3)."""
    compiler, runtime = shutil.which("mcs"), shutil.which("mono")
    if compiler is None or runtime is None:
        pytest.skip("mono is not installed")
    (folder / "program.cs").write_text(PROGRAM, "utf-8")
    made = folder / "program.exe"
    built = subprocess.run([compiler, f"-out:{made}", str(PLAYER), str(folder / "program.cs")], capture_output=True,
                           check=False)  # fmt: skip
    assert built.returncode == 0, (built.stdout + built.stderr).decode()
    for name, values in (("raw", acts), ("pins", pins), ("q", q)):
        if values is not None:
            (folder / name).write_bytes(np.ascontiguousarray(values, np.float32).tobytes())
    given = [model_path, folder / "raw", folder / "pins", folder / "out", "-" if q is None else folder / "q", steps]
    done = subprocess.run([runtime, str(made), *map(str, given)], capture_output=True, check=False, timeout=300)
    assert done.returncode == 0, done.stderr.decode()
    return np.fromfile(folder / "out", np.float32).reshape(steps + 1, 2, -1, 3).swapaxes(0, 1)


def test_the_player_in_csharp_gives_the_motion_of_a_network(scene, model, tmp_path):
    save(model, tmp_path / "m.npz")
    played = play(model, scene, STEPS + 1)
    acts = np.concatenate([table for _, table in raw(build(scene, 0, steps=STEPS), STEPS)], axis=1)
    x, normals = by_mono(tmp_path, tmp_path / "m.npz", acts, pins_of(scene, STEPS), STEPS)
    assert off(x, played.motion.positions) < CLOSE
    by = model.parts[0].normals.astype(float)
    made = by[:, :, 0] + np.einsum("nir,fr->fni", by[:, :, 1:], played.coordinates[0])
    made /= np.linalg.norm(made, axis=2, keepdims=True)
    np.testing.assert_allclose(normals, made, atol=1e-3)  # some random sums are near 0


def test_the_player_in_csharp_decodes_the_motion_of_physics(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    scene = scene_of(subspaces.moving())
    own = subspaces.model_of(scene, 6)
    (part,) = own.parts
    rounded = part.basis.astype(np.float16).astype(float)
    save(dataclasses.replace(own, parts=(dataclasses.replace(part, basis=rounded, half=True),)), "m.npz")
    asked = ["--frames", "41", "-o", "x.npz", "--coordinates", "q.npz", "-q"]
    assert run(["subspace", "play", "m.npz", *asked]) == 0
    x, normals = by_mono(tmp_path, "m.npz", np.zeros(0), pins_of(scene, 40), 40, np.load("q.npz")["q0"])
    played = np.load("x.npz")["positions"]
    assert off(x, played) < CLOSE
    exact = Decoder(scene.cloths[0].positions, part.basis, scene.cloths[0].triangles).normals(played.astype(np.float32))
    np.testing.assert_allclose(normals, exact, atol=1e-4)
