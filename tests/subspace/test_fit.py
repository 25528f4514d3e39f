"""Fits in the subspace: what they find, in how few full simulations, and what they refuse."""

import numpy as np
import pytest
from helpers.scenes import cloth, document, even, write_scene
from helpers.subspaces import scene_of

import clothfit
from clothfit.base.errors import InvalidInput
from clothfit.cli.program import run
from clothfit.subspace.fit import fit

pytestmark = pytest.mark.slow  # compiles derivatives


def test_the_values_of_a_motion_are_found():
    truth = scene_of(even("GG", 30, 5, 5, vertIsFixed=[i < 5 for i in range(25)], windVel={"x": 2, "y": 0, "z": 1}))
    target = clothfit.simulate(truth)
    start = clothfit.with_parameters(truth, [0.03, 21.0])
    found = fit(truth, target, start, size=40)
    # springs without bending crumple; 40 of 60 coordinates leave a little out
    np.testing.assert_allclose(clothfit.parameters(found.scene), [0.02, 30.0], rtol=2e-3)
    assert found.rounds <= 4
    assert found.evaluations > found.rounds


def test_a_target_of_which_little_is_seen_serves_too():
    truth = scene_of(even("nG", 30, 5, 5, vertIsFixed=[i < 5 for i in range(25)]))
    target = clothfit.degrade(clothfit.simulate(truth), observed=0.3, seed=1)
    found = fit(truth, target, clothfit.with_parameters(truth, [40.0]), size=40)
    assert clothfit.parameters(found.scene)[0] == pytest.approx(30.0, rel=5e-3)


@pytest.mark.parametrize(
    ("settings", "fields", "said"),
    [("nn", {}, "fits 1 to 64 values; the scene flags 0"), ("nL", {}, "the scene flags 85"),
     ("nn", {"fit": {"friction": "G"}}, "does not fit friction")],
)  # fmt: skip
def test_what_it_cannot_fit_is_refused(settings, fields, said):
    zero = {"x": 0, "y": 0, "z": 0}
    floor = {"type": 1, "pos": {**zero, "y": -9}, "rot": zero, "scale": {"x": 1, "y": 1, "z": 1}, "friction": 0.1}
    scene = scene_of(document(cloth(6, 6, optimizationSettings=settings), colliders=[floor],
                              optimizationIterations=5, **fields))  # fmt: skip
    with pytest.raises(InvalidInput, match=said):
        fit(scene, clothfit.simulate(scene), None)


def test_the_command_goes_on_in_full(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    write_scene(tmp_path, even("nG", 20, 5, 5, vertIsFixed=[i < 5 for i in range(25)]))
    assert run(["target", "scene.json", "-o", "t.npz", "-q"]) == 0
    assert run(["estimate", "scene.json", "--target", "t.npz", "--start", "20", "--subspace", "-o", "f.json"]) == 0
    assert "subspace" in capsys.readouterr().err
    found = clothfit.parameters(clothfit.load("f.json"))[0]
    assert found == pytest.approx(30.0, rel=1e-6)  # the full fit's own accuracy
    assert run(["estimate", "scene.json", "--subspace"]) == 2
    assert "--subspace is for the motion of --target" in capsys.readouterr().err
