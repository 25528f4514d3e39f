"""The examples in which the world moves: they come from their generator, and fits find their values."""

from importlib.util import module_from_spec, spec_from_file_location

import numba
import numpy as np
import pytest
from helpers.paths import EXAMPLES

import clothfit
from clothfit.engine.forces.touch import depths
from clothfit.engine.system import at_rest
from clothfit.evaluation.forecast import inputs_of

WORLD = EXAMPLES / "world"
SHORT = 25
"""Frames, of the 80: enough to tell the values, at a third of the time."""

slow = pytest.mark.slow
compiled = pytest.mark.skipif(numba.config.DISABLE_JIT, reason="whole motions are slow without compilation")


def generator():
    """The module examples/world/make.py."""
    spec = spec_from_file_location("world_make", WORLD / "make.py")
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_files_are_what_the_generator_makes_and_there_are_no_others():
    made = generator().files()
    assert {path.name: path.read_text("ascii") for path in WORLD.iterdir() if path.suffix in (".json", ".csv")} == made


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


def test_the_cape_begins_outside_of_the_figure():
    scene = clothfit.load(WORLD / "cape.json")
    free = ~scene.cloths[0].fixed
    depth, _ = depths(at_rest(scene, len(scene.cloths[0].mass)), np.array(scene.cloths[0].positions))
    assert depth[:, free].max() < 0.02  # m; the first steps push out what is in


@slow
@compiled
@pytest.mark.parametrize(("name", "frames"), [("cape", 80), ("tablecloth", SHORT), ("curtain", SHORT), ("flag", SHORT)])
def test_a_fit_finds_the_values_of_a_motion_played_with_others(name, frames):
    scene = clothfit.load(WORLD / f"{name}.json")
    scene = scene.with_step(scene.delta, frames)
    true = clothfit.parameters(scene)
    found = clothfit.estimate(clothfit.with_parameters(scene, 1.05 * true), clothfit.simulate(scene, tolerance=1e-12))
    np.testing.assert_allclose(clothfit.parameters(found.scene), true, rtol=1e-4)


@slow
@compiled
def test_a_fit_finds_the_gusts_of_a_table():
    flag, calm = (clothfit.load(WORLD / f"{name}.json") for name in ("flag", "calm"))
    calm = calm.with_step(calm.delta, SHORT)
    found = clothfit.estimate(calm, clothfit.simulate(flag, SHORT, tolerance=1e-12)).scene
    table = np.loadtxt(WORLD / "gusts.csv", delimiter=",", skiprows=1)[:, 1:]
    # 24 steps of 0.02 s end before the sixth key; of the first one, wind along the flag, which is flat, moves nothing
    np.testing.assert_allclose(found.gusts[1:5], table[1:5], atol=1e-3)
