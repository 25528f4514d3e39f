"""Scene and marker files of other programs, as the commands use them: there and back, fits, damage."""

import json
import shlex
from pathlib import Path

import numpy as np
import pytest
from helpers.scenes import trial, write_scene

import clothfit
from clothfit.base.errors import InvalidInput
from clothfit.base.writing import write_atomically
from clothfit.cli.program import run
from clothfit.formats.registry import FORMATS

pytestmark = pytest.mark.slow  # compiles a fit

SCENE = clothfit.load(trial("nG", 12))
MOTION = clothfit.simulate(SCENE)
@pytest.fixture
def there(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_scene(tmp_path, trial("nG", 12))
    return tmp_path


def gapped():
    """The motion with a vertex that is hidden for a time."""
    observed = np.ones(MOTION.positions.shape[:2], bool)
    observed[4:7, 5] = False
    return clothfit.as_motion(SCENE, MOTION.positions, MOTION.times, observed)


@pytest.mark.parametrize("suffix", ["c3d", "trc", "csv"])
def test_gaps_come_back(there, suffix):
    clothfit.save_motion(gapped(), f"a.{suffix}", SCENE)
    np.testing.assert_array_equal(clothfit.load_motion(f"a.{suffix}", SCENE).observed, gapped().observed)


@pytest.mark.parametrize("suffix", ["usda", "glb"])
def test_faces_come_back_as_the_scene_has_them(there, suffix):
    clothfit.save_motion(MOTION, f"a.{suffix}", SCENE)
    assert run(shlex.split(f"convert a.{suffix} b.npz -q")) == 0
    np.testing.assert_array_equal(np.load("b.npz")["triangles"], SCENE.cloths[0].triangles)


# Positions are rounded to 1e-7 of a motion of a metre; what is fitted to it moves by a few times that.
def test_a_fit_to_it_is_the_fit_to_the_motion(there, capsys):
    clothfit.save_motion(MOTION, "a.c3d", SCENE)
    assert run(shlex.split("estimate scene.json --target a.c3d --start 2 -o b.json --json")) == 0
    fit = clothfit.estimate(SCENE, MOTION, start=2.0)
    assert json.loads(capsys.readouterr().out)["rmse"] == pytest.approx(fit.rmse, rel=1e-3)
    np.testing.assert_allclose(clothfit.parameters(clothfit.load("b.json")), clothfit.parameters(fit.scene), rtol=1e-4)


@pytest.mark.parametrize("suffix", [each.suffixes[0] for each in FORMATS])
def test_garbage_costs_one_message(there, capfd, suffix):
    (there / f"a{suffix}").write_bytes(b"\xff\0glTF" * 99)
    assert run(["convert", f"a{suffix}", "b.npz"]) == 3
    out, err = capfd.readouterr()
    assert out == ""
    assert err.startswith(f"error: a{suffix}: ")
    assert err.count("\n") == 1
    assert not (there / "b.npz").exists()


# Half of a sequence looks like a whole one.
@pytest.mark.parametrize("before", [(), ("a_0001.obj",)])
def test_a_sequence_that_cannot_be_written_whole_leaves_nothing_new(there, before, monkeypatch):
    for name in before:
        Path(name).write_text("old")

    def full(path, data):
        if path.endswith("2.obj"):
            raise InvalidInput("cannot write")
        write_atomically(path, data)

    monkeypatch.setattr(clothfit.motion.files, "write_atomically", full)
    with pytest.raises(InvalidInput, match="cannot write"):
        clothfit.save_motion(MOTION, "a_*.obj", SCENE)
    assert [path.name for path in Path().glob("a_*")] == list(before)
