"""The example scenes: what they promise, that they come from their generators, and that fits find their values."""


import numpy as np
import pytest
from helpers.modules import script
from helpers.paths import EXAMPLES

import clothfit
from clothfit.engine.forces.collider_rows import depths
from clothfit.engine.system import at_rest
from clothfit.evaluation.forecast import inputs_of

KEYFRAMES, WORLD = EXAMPLES / "keyframes", EXAMPLES / "world"

pytestmark = pytest.mark.slow  # compiles a fit


@pytest.mark.parametrize("folder", [EXAMPLES, KEYFRAMES, WORLD], ids=lambda folder: folder.name)
def test_the_files_are_what_the_generator_makes_and_there_are_no_others(folder):
    make = script(folder / "make.py")
    there = {path.name: path.read_text("ascii") for path in folder.iterdir() if path.suffix in (".json", ".csv")}
    if folder == KEYFRAMES:
        there.pop("curtain.keys.json")  # of a simulation, whose last digits depend on the machine
    if folder == EXAMPLES:  # beside which demonstrations write their results
        made = {name: make.text(scene()) for name, scene in make.SCENES.items()}
        assert there == {**{name: text for name, text in there.items() if ".fitted" in name}, **made}
    else:
        assert there == make.files()


@pytest.mark.parametrize(
    ("path", "name", "steps"),
    [(EXAMPLES / "flag.json", "flag", [50, 100]), (KEYFRAMES / "sheet.json", "sheet", [60, 80]),
     (KEYFRAMES / "curtain.json", "curtain", [100])],
)  # fmt: skip
def test_keys_belong_to_their_scene(path, name, steps):
    loaded = clothfit.load(path)
    keys = clothfit.load_keys(str(KEYFRAMES / f"{name}.keys.json"), loaded)
    assert ([key.step for key in keys], loaded.warnings) == (steps, ())


@pytest.mark.parametrize(
    ("name", "places"),
    [
        ("cape", {"objects[0].pins[0].posKeys", "colliders[0].posKeys", "colliders[3].rotKeys"}),
        ("curtain", {"objects[0].pins[0].posKeys", "objects[0].pins[8].posKeys"}),
        ("tablecloth", set()),
        ("flag", {"windVelKeys"}),
        ("calm", {"windVelKeys"}),
    ],
)
def test_a_scene_has_the_inputs_that_it_says(name, places):
    scene = clothfit.load(WORLD / f"{name}.json")
    assert places <= {each.place for each in inputs_of(scene)}
    assert bool(places) == bool(inputs_of(scene))
    assert scene.warnings == ()
    if name == "cape":  # it begins outside of the figure
        (own,) = scene.cloths
        depth, _ = depths(at_rest(scene, len(own.mass)), np.array(own.positions))
        assert depth[:, ~own.fixed].max() < 0.02  # m; the first steps push out what is in


@pytest.mark.parametrize(("name", "frames"), [("cape", 20), ("tablecloth", 10), ("curtain", 15), ("flag", 15)])
def test_a_fit_finds_the_values_of_a_motion_played_with_others(name, frames):
    scene = clothfit.load(WORLD / f"{name}.json")
    scene = scene.with_step(scene.delta, frames)
    true = clothfit.parameters(scene)
    found = clothfit.estimate(clothfit.with_parameters(scene, 1.05 * true), clothfit.simulate(scene, tolerance=1e-12))
    np.testing.assert_allclose(clothfit.parameters(found.scene), true, rtol=1e-4)


def test_a_fit_finds_the_gusts_of_a_table():
    flag, calm = (clothfit.load(WORLD / f"{name}.json") for name in ("flag", "calm"))
    found = clothfit.estimate(calm.with_step(calm.delta, 25), clothfit.simulate(flag, 25, tolerance=1e-12)).scene
    table = np.loadtxt(WORLD / "gusts.csv", delimiter=",", skiprows=1)[:, 1:]
    # 24 steps of 0.02 s end before the sixth key; of the first one, wind along the flag, which is flat, moves nothing
    np.testing.assert_allclose(found.gusts[1:5], table[1:5], atol=1e-3)
