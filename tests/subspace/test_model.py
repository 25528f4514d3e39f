"""From a scene to a model and back from its file; what it follows, clamps and refuses."""

import json

import numpy as np
import pytest
from helpers.scenes import cloth, document, write_scene
from helpers.subspaces import scene_of

from clothfit.base.errors import InvalidInput
from clothfit.cli.program import run
from clothfit.engine.system import build as build_system
from clothfit.subspace.build import CUBATURES, Options, build, coarsest
from clothfit.subspace.inputs import Ranges, episodes
from clothfit.subspace.model import load_model, save
from clothfit.subspace.physics.cubature import Found
from clothfit.subspace.physics.samples import Reduced
from clothfit.subspace.play import play
from clothfit.subspace.recording import Data, record

pytestmark = pytest.mark.slow  # compiles motions with inputs


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A model of a small cloth in gusts, and the data it was built of."""
    place = tmp_path_factory.mktemp("subspace")
    held = [i < 5 for i in range(25)]
    scene = scene_of(document(cloth(5, 5, damping=0.5, vertIsFixed=held), optimizationIterations=60))
    ranges = Ranges(2.0)
    path = place / "data.npz"
    found = record(scene, episodes(scene, ranges, 5, 1.2, 0), ranges, 60, path)
    assert (found.left_out, found.diverged, found.frames) == (0, 0, 5 * 61)
    data = Data(path)
    return place, data, *build(data, Options(size=24))


def test_a_motion_that_it_was_not_built_of_is_followed(made):
    _, _, _, (report,) = made
    assert report.vectors == 24
    assert report.whole.relative < 0.03  # a cloth without bending springs crumples: 24 of its 60 coordinates miss that
    assert report.sampled.relative < 0.03
    assert report.left_out[16] > report.left_out[24] > 0
    assert max(report.errors.values()) <= max(CUBATURES)


def test_the_coarsest_cubature_is_taken_that_is_good_enough(made):
    _, data, model, _ = made
    basis, (x, _) = model.parts[0].basis, data.motion(0, 0)
    own = Reduced(build_system(data.scene_of(0), 0, steps=data.steps), basis)
    whole, last = Found(own.chosen, {}), Found(model.parts[0].chosen, {})
    poor = Found(type(own.chosen)(*(each[:1] for each in own.chosen)), {})
    assert coarsest(own, basis, [poor, whole, last], x) is whole
    assert coarsest(own, basis, [poor, poor, last], x) is last


def test_its_file_gives_the_same_motion(made):
    place, data, model, _ = made
    save(model, place / "model.npz")
    again, scene = load_model(place / "model.npz"), data.scene_of(4)
    both = [play(each, scene, 40).motion.positions for each in (model, again)]
    np.testing.assert_array_equal(*both)


def test_data_and_models_are_the_same_for_the_same_seed(made):
    place, data, model, _ = made
    again = place / "again.npz"
    record(data.scene, episodes(data.scene, data.ranges, 5, 1.2, 0), data.ranges, 60, again)
    np.testing.assert_array_equal(Data(again).motion(3, 0)[0], data.motion(3, 0)[0])
    other, _ = build(Data(again), Options(size=24))
    np.testing.assert_array_equal(other.parts[0].basis, model.parts[0].basis)
    np.testing.assert_array_equal(other.parts[0].chosen.spring_weight, model.parts[0].chosen.spring_weight)


def test_inputs_beyond_the_range_are_clamped_and_said_once(made):
    _, data, model, _ = made
    from clothfit.subspace.inputs import applied

    storm = [{"acts": "wind", "times": [0, 0.5, 3], "values": [[0, 0, 0], [0, 9e5, 0], [4e5, 0, 0]]}]
    played = play(model, applied(data.scene, storm), 120)
    assert len(played.clamped) == 1
    assert "wind leaves the range" in played.clamped[0]
    reach = np.abs(np.concatenate([data.motion(e, 0)[0] for e in range(4)])).max()
    moved = played.motion.positions - played.motion.positions[0]
    assert np.abs(moved).max() < 3 * reach  # pushed as hard as ever recorded, and for longer
    assert play(model, data.scene_of(0), 20).clamped == []


def test_it_comes_to_rest_when_its_inputs_do(made):
    _, data, model, _ = made
    from clothfit.subspace.inputs import applied

    gust = [{"acts": "wind", "times": [0, 0.3, 0.6], "values": [[0, 0, 0], [4, 0, -4], [0, 0, 0]]}]
    x = play(model, applied(data.scene, gust), 1200).motion.positions
    speed = np.abs(np.diff(x, axis=0)).max(axis=(1, 2))
    assert speed[-1] < 1e-6 * speed.max()  # damping of 0.5/s for 23 s, and that of the integrator


def test_an_error_asks_for_as_many_vectors_as_it_needs(made):
    _, data, _, (before,) = made
    _, (found,) = build(data, Options(error=2 * before.left_out[16], cubature=()))
    assert 8 < found.vectors <= 16
    assert found.elements["springs"][0] == found.elements["springs"][1]


def test_few_coordinates_need_few_elements(made):
    _, data, _, _ = made
    _, (found,) = build(data, Options(size=6, cubature=(0.05,)))
    used = {kind: (few, there) for kind, (few, there) in found.elements.items() if there and kind != "vertices"}
    assert all(0 < few < 0.7 * there for few, there in used.values())
    assert max(found.errors.values()) <= 0.05


def test_files_that_are_none_are_refused(made, tmp_path):
    place, _data, model, _ = made
    save(model, tmp_path / "m.npz")
    content = (tmp_path / "m.npz").read_bytes()
    (tmp_path / "half.npz").write_bytes(content[: len(content) // 2])
    (tmp_path / "other.npz").write_bytes((place / "data.npz").read_bytes())
    for name in ("half.npz", "other.npz", "none.npz"):
        with pytest.raises(InvalidInput, match=name):
            load_model(tmp_path / name)
    with pytest.raises(InvalidInput, match=r"m\.npz: it is no data"):
        Data(tmp_path / "m.npz")
    other = scene_of(document(cloth(3, 3)))
    with pytest.raises(InvalidInput, match="its objects are not those of the model"):
        play(model, other, 5)


def test_the_commands(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    write_scene(tmp_path, document(cloth(4, 4, damping=0.5), optimizationIterations=30))
    (tmp_path / "w.json").write_text(
        json.dumps({"inputs": [{"acts": "wind", "times": [0, 0.3], "values": [[0, 0, 0], [2, 0, 2]]}]})
    )
    few = ["--episodes", "3", "--frames", "40"]
    assert run(["subspace", "record", "scene.json", *few, "--wind", "4", "-q"]) == 0
    assert run(["subspace", "build", "scene.data.npz", "--basis", "12", "-o", "a.npz", "-q"]) == 0
    own = [*few, "--wind", "4", "--basis", "12", "--normals", "-o", "b.npz", "--json"]
    assert run(["subspace", "build", "scene.json", *own]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["objects"][0]["vectors"] == 12
    np.testing.assert_array_equal(load_model("a.npz").parts[0].basis, load_model("b.npz").parts[0].basis)
    assert run(["subspace", "play", "a.npz", "--inputs", "w.json", "--frames", "25", "-o", "m.npz", "-q"]) == 0
    assert np.load("m.npz")["positions"].shape == (25, 16, 3)
    assert load_model("a.npz").parts[0].normals is None
    assert load_model("b.npz").parts[0].normals.shape == (16, 3, 13)
    crowd = ["--instances", "3", "--frames", "8", "-o", "c.npz", "--seed", "1"]
    assert run(["subspace", "play", "b.npz", *crowd, "--json", "-q"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["outputs"] == ["c-1.npz", "c-2.npz", "c-3.npz"]
    assert set(said["us_per_frame"]) == {"state", "decode", "normals"}
    assert np.load("c-1.npz")["positions"].shape == (8, 16, 3)
    assert np.abs(np.load("c-1.npz")["positions"] - np.load("c-2.npz")["positions"]).max() > 1e-6
    assert run(["subspace", "play", "b.npz", "--push-out", "0", "-q"]) == 3
    assert "the scene has no obstacles" in capsys.readouterr().err
    assert run(["subspace", "play", "b.npz", "--instances", "2", "--push-out", "0"]) == 2
    assert "--push-out does not go with --instances" in capsys.readouterr().err
    assert run(["evaluate", "scene.json", "a.npz", "--inputs", "w.json", "--json", "-q"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["relative_rmse"] < 0.1
    assert set(found["us_per_frame"]) == {"state", "decode", "normals"}
    assert {"drift", "energy", "energy_gain", "normals"} <= set(found)
    shown = ["--plot", "p.png", "--report", "p.html", "--steps", "20"]
    assert run(["evaluate", "scene.json", "b.npz", *shown, "-q"]) == 0
    assert {"p.png", "p.html"} <= {each.name for each in tmp_path.iterdir()}
    assert run(["evaluate", "scene.json", "scene.json", "--report", "q.html"]) == 2
    assert "--report goes with a subspace only" in capsys.readouterr().err
    assert run(["evaluate", "scene.json", "b.npz", "--report", "b.npz"]) == 3
    assert "it is an input or another output" in capsys.readouterr().err
    assert found["full_us_per_step"] > 0
    assert run(["info", "a.npz"]) == 3
    assert "clothfit subspace play" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        (["play", "scene.json"], 3, "no model of clothfit subspace build"),
        (["build", "scene.json", "--inputs", "w.json"], 2, "--inputs does not go with build"),
        (["play", "scene.json", "--basis", "3"], 2, "--basis does not go with play"),
        (["build", "scene.json", "--error", "soft"], 3, "'soft' is no length"),
        (["play", "scene.json", "--instances", "0"], 3, "--instances must be at least 1"),
        (["play", "scene.json", "--normals"], 2, "--normals does not go with play"),
        (["play", "scene.json", "--push-out", "far"], 3, "no model of clothfit subspace build"),
        (["build", "scene.json", "--basis", "0"], 3, "--basis must be between 1 and 512"),
        (["record", "scene.json", "--episodes", "1"], 3, "--episodes must be at least 2"),
        (["record", "scene.json", "--wind", "-1"], 3, "--wind must be at least 0"),
        (["record", "none.json"], 3, "none.json: there is no such file"),
    ],
)
def test_bad_input_costs_one_sentence(tmp_path, monkeypatch, capsys, arguments, code, said):
    monkeypatch.chdir(tmp_path)
    write_scene(tmp_path, document(cloth(3, 3)))
    assert run(["subspace", *arguments]) == code
    assert said in capsys.readouterr().err
