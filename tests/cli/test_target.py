"""`clothfit target`: the file, the degradations, the summary."""

import json

import numpy as np
import pytest
from helpers.scenes import cloth, document, write_scene

from clothfit.cli.program import run
from clothfit.fit.estimate import record_target
from clothfit.motion.degrade import degrade
from clothfit.motion.motion import load_motion
from clothfit.scene.scene import load

pytestmark = pytest.mark.slow  # starts processes

KEYS = {"schema_version", "command", "scene", "frames", "observed", "noise", "output"}


@pytest.fixture
def path(tmp_path):
    """A small scene of two objects."""
    objects = (cloth(4, 4, optimizationSettings="nG"), cloth(2, 2))
    return write_scene(tmp_path, document(*objects, optimizationIterations=9))


def recorded(path, *options):
    """The motion that the command writes beside the scene."""
    assert run(["target", path, "-q", *options]) == 0
    return load_motion(path.replace(".json", ".target.npz"), load(path))


def test_the_perfect_motion_of_all_objects_goes_beside_the_scene(path, tmp_path):
    found, true = recorded(path), record_target(load(path))
    np.testing.assert_array_equal(found.positions, true.positions)
    np.testing.assert_array_equal(found.times, true.times)
    assert found.observed is None
    assert sorted(item.name for item in tmp_path.iterdir()) == ["scene.json", "scene.target.npz"]


def test_the_options_are_those_of_the_library(path, capsys):
    options = ("--noise", "0.001", "--observed", "0.25", "--every", "2", "--seed", "4", "--steps", "12", "--json")
    found = recorded(path, *options)
    summary = json.loads(capsys.readouterr().out)
    assert set(summary) == KEYS
    assert (summary["frames"], summary["observed"], summary["noise"]) == (7, 0.25, 1e-3)
    same = degrade(record_target(load(path), 13), 0.001, 0.25, 2, 4)
    assert len(found.times) == 7
    np.testing.assert_array_equal(found.positions, same.positions)
    np.testing.assert_array_equal(found.observed, same.observed)
    np.testing.assert_array_equal(found.times, same.times)
    assert [int(found.seen(i)[0].sum()) for i in range(2)] == [4, 1]
    assert run(["target", path]) == 0
    assert "9 frames, 100% seen, no noise → " in capsys.readouterr().err


def test_a_frame_rate(path):
    found = recorded(path, "--fps", "30")
    np.testing.assert_array_equal(found.positions, degrade(record_target(load(path)), fps=30).positions)
    np.testing.assert_allclose(found.times, np.arange(5) / 30, rtol=1e-15)  # of 0.16 s; one quotient each
    assert run(["target", path, "--fps", "30", "--every", "2"]) == 3


def test_through_pipes(path, capsysbinary, standard_input):
    standard_input(path)
    assert run(["target", "-", "--every", "4", "-q"]) == 0
    out, err = capsysbinary.readouterr()
    assert (out[:2], err) == (b"PK", b"")
