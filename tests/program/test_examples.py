"""The example scenes: what they promise, and that they come from their generator."""

import json
import subprocess
import sys
from importlib.util import module_from_spec, spec_from_file_location

import numba
import numpy as np
import pytest
from helpers.paths import EXAMPLES

import clothfit

pytestmark = pytest.mark.slow  # starts processes

SETTINGS = {"side": "nL", "corners": "Ln", "flag": "nG", "drape": "Gn"}
FIXED = {
    "side": list(range(132, 144)),
    "corners": [0, 11, 132, 143],
    "flag": list(range(0, 144, 12)),
    "drape": [],
}

slow_in_python = pytest.mark.skipif(numba.config.DISABLE_JIT, reason="whole motions are slow without compilation")


def generator():
    """The module examples/make.py."""
    spec = spec_from_file_location("examples_make", EXAMPLES / "make.py")
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(params=SETTINGS)
def name(request):
    return request.param


@pytest.fixture
def scene(name):
    return clothfit.load(EXAMPLES / f"{name}.json")


def test_there_are_no_others():
    found = {path.name for path in EXAMPLES.glob("*.json") if ".fitted" not in path.name}
    assert found == {f"{name}.json" for name in SETTINGS} == set(generator().SCENES)


def test_a_scene_is_what_the_generator_makes(name):
    make = generator()
    assert (EXAMPLES / f"{name}.json").read_bytes() == make.text(make.SCENES[f"{name}.json"]()).encode()


def test_a_scene_is_a_plane_of_144_vertices_and_726_springs(scene):
    (cloth,) = scene.cloths
    assert cloth.positions.shape == (144, 3)
    assert cloth.springs.shape == (726, 2)
    assert cloth.triangles.shape == (242, 3)
    assert np.ptp(cloth.positions, axis=0).max() == 7.0


def test_a_scene_has_the_studys_numbers(scene):
    (cloth,) = scene.cloths
    assert (scene.method, scene.newton_iterations) == (2, 1)
    assert (scene.delta, scene.frames, scene.tolerance) == (0.02, 100, 1e-5)
    assert (cloth.damping, cloth.drag) == (0.1, 0.1)
    assert cloth.mass.sum() == pytest.approx(0.1 * 7.0**2, rel=1e-10)  # 12 digits are written
    assert cloth.stiffness.max() == pytest.approx(50.0, rel=1e-10)
    assert scene.warnings == ()


def test_a_scene_is_held_where_it_says(scene, name):
    (cloth,) = scene.cloths
    assert np.flatnonzero(cloth.fixed).tolist() == FIXED[name]
    assert scene.title == name


def test_a_scene_asks_what_it_says(scene, name):
    (cloth,) = scene.cloths
    assert cloth.settings == SETTINGS[name]
    assert clothfit.parameters(scene).shape == ({"nL": 726, "Ln": 144, "nG": 1, "Gn": 1}[cloth.settings],)


def test_only_the_flag_is_upright_and_in_the_wind(scene, name):
    level = np.ptp(scene.cloths[0].positions[:, 1]) == 0.0
    assert (scene.wind.tolist(), level) == (([106.066, 0.0, -106.066], False) if name == "flag" else ([0.0] * 3, True))


def test_the_fixed_side_of_the_flag_is_upright_and_to_windward():
    flag = clothfit.load(EXAMPLES / "flag.json")
    pole = flag.cloths[0].positions[flag.cloths[0].fixed]
    assert (pole[:, 0] == -3.5).all()
    assert np.ptp(pole[:, 1]) == 7.0
    assert flag.wind[0] > 0


def test_only_the_drape_has_a_sphere_under_it(scene, name):
    below = [scene.cloths[0].positions[:, 1].min() - (ball.centre[1] + ball.radius) for ball in scene.spheres]
    assert below == pytest.approx([0.1] if name == "drape" else [], rel=1e-12)


@slow_in_python
def test_the_drape_lands_on_the_sphere_and_stays_out_of_it():
    scene = clothfit.load(EXAMPLES / "drape.json")
    (ball,) = scene.spheres
    motion = clothfit.simulate(scene).positions
    depth = ball.radius - np.linalg.norm(motion - ball.centre, axis=2)
    way = np.linalg.norm(np.diff(motion, axis=0), axis=2)
    assert depth.max() > 0.0
    assert depth.max() < way.max()  # a vertex enters within one step, and the push then turns it back


@slow_in_python
def test_a_cloth_moves_and_what_holds_it_does_not(scene):
    motion = clothfit.simulate(scene).positions
    fixed = scene.cloths[0].fixed
    assert motion.shape == (100, 144, 3)
    np.testing.assert_array_equal(motion[:, fixed], np.broadcast_to(motion[0, fixed], motion[:, fixed].shape))
    assert np.abs(motion[-1] - motion[0]).max() > 1.0


def test_the_files_are_laid_out_one_array_per_line(name):
    lines = (EXAMPLES / f"{name}.json").read_text("utf-8").splitlines()
    assert len(lines) == 22
    assert sum('"vertMass": [' in line and line.endswith("],") for line in lines) == 1


def test_the_check_says_that_all_is_up_to_date():
    done = subprocess.run(
        [sys.executable, str(EXAMPLES / "make.py"), "--check"], capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


def test_the_generator_writes_what_is_missing_or_stale_and_checks_without_writing(tmp_path, monkeypatch, capsys):
    make = generator()
    monkeypatch.setattr(make, "FOLDER", tmp_path)
    monkeypatch.setattr(sys, "argv", ["make.py", "--check"])
    assert make.main() == 1
    assert list(tmp_path.iterdir()) == []
    monkeypatch.setattr(sys, "argv", ["make.py"])
    assert make.main() == 0
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == {
        f"{name}.json": (EXAMPLES / f"{name}.json").read_bytes() for name in SETTINGS
    }
    capsys.readouterr()
    assert make.main() == 0
    assert capsys.readouterr().out == ""
    (tmp_path / "flag.json").write_text(json.dumps({}))
    monkeypatch.setattr(sys, "argv", ["make.py", "--check"])
    assert make.main() == 1
    assert capsys.readouterr().out == "flag.json: not up to date; run python examples/make.py\n"
