"""Hints: what targets show before a fit, and what motions of the model itself never show."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.fits import estimate
from helpers.scenes import cloth, document

from clothfit import degrade, load, simulate, with_parameters
from clothfit.fit.hints import hints_of, other_step

pytestmark = pytest.mark.slow  # compiles a simulation


def sheet(nx=10, ny=10, held="side", frames=12, **fields):
    """A horizontal sheet with 0.1 m between its vertices."""
    n = nx * ny
    fixed = [i < nx if held == "side" else i in (0, nx - 1) for i in range(n)] if held else [False] * n
    stiffness = [20.0] * len(cloth(nx, ny)["springStiffness"])
    own = cloth(nx, ny, 0.1, vertIsFixed=fixed, vertMass=[0.002] * n, springStiffness=stiffness)
    scene = {name: fields.pop(name) for name in ("delta", "windVel", "gravity", "integrationMethod") if name in fields}
    made = document({**own, "optimizationSettings": "nG", **fields}, optimizationIterations=frames, **scene)
    return load(made)


def codes(scene, motion):
    return [hint.code for hint in hints_of(scene, motion)]


def test_a_target_that_goes_on_after_the_scene_is_named():
    scene = sheet(frames=12)
    (hint,) = hints_of(scene, simulate(scene.with_step(scene.delta, frames=16)))
    assert hint.code == "ends_early"
    assert "3 of 16 frames" in hint.text
    assert codes(scene, simulate(scene.with_step(scene.delta, frames=13))) == []  # a frame within a step of the end


@pytest.mark.parametrize("held", ["side", "corners", None])
@pytest.mark.parametrize("noise", [0.0, 1e-3])
def test_the_model_itself_gives_no_hint(held, noise):
    for seed, (damping, drag, wind) in enumerate([(0.0, 0.0, 0.0), (10.0, 1.0, 0.0), (0.1, 1e4, 5.0), (3.0, 1e3, 0.0)]):
        scene = sheet(held=held, damping=damping, dragCoefficient=drag, windVel={"x": 0.0, "y": wind, "z": 0.0})
        motion = simulate(scene)
        seen = degrade(motion, noise, seed=seed) if noise else motion
        assert codes(sheet(held=held, windVel={"x": 0.0, "y": wind, "z": 0.0}), seen) == []


def test_a_frame_that_is_not_the_first_but_shows_the_start_is_named():
    scene = sheet(frames=12)
    motion = simulate(scene)
    (hint,) = hints_of(scene, replace(motion, positions=motion.positions[::-1]))
    assert (hint.code, "its frame 11 of 12" in hint.text, "in reverse?" in hint.text) == ("frame_order", True, True)
    late = replace(motion, positions=np.concatenate([motion.positions[4:0:-1], motion.positions[:8]]))
    assert "frames 4:" in next(hints_of(scene, late)).text


@pytest.mark.parametrize("damping", [0.0, 3.0])
@pytest.mark.parametrize("held", ["side", "corners", None])
def test_nor_does_it_by_bdf2_whose_first_step_is_half_a_step_ahead(held, damping):
    scene = sheet(held=held, damping=damping, integrationMethod=3)
    assert codes(scene, simulate(scene)) == []
    slow = simulate(sheet(held=held, damping=damping, integrationMethod=3, gravity={"x": 0.0, "y": -5.6, "z": 0.0}))
    assert codes(scene, slow) == ["time_scale"]


@pytest.mark.parametrize("rate", [0.7, 1.32, 2.0])
def test_another_clock_is_seen_in_the_fall_but_not_where_gravity_is_fitted(rate):
    scene = sheet(frames=20)  # longer than the slowest of these targets
    motion = simulate(sheet(delta=0.005, frames=30, damping=0.5))
    seen = replace(motion, times=motion.times * rate)
    (hint,) = hints_of(scene, seen)
    assert hint.code == "time_scale"
    value = float(hint.text.split("falls at ")[1].split()[0])
    assert value == pytest.approx(9.81 / rate**2, rel=0.01)  # three digits are shown
    assert "--fit-time" in hint.text
    assert codes(replace(scene, fits={"gravity": "G"}), seen) == []


def test_a_slower_fall_of_few_noisy_markers_is_seen():
    scene = sheet(frames=20)
    slow = simulate(sheet(frames=20, gravity={"x": 0.0, "y": -5.6, "z": 0.0}))
    few = degrade(slow, 3e-4, observed=0.3, seed=1)
    assert codes(scene, few) == ["time_scale"]


# --- the place, the size and the vertices


@pytest.fixture(scope="module")
def own():
    """A sheet, its motion, and the same with noise."""
    scene = sheet()
    motion = simulate(scene)
    return scene, motion, degrade(motion, 1e-3, seed=1)


def test_a_target_that_is_moved_and_turned_is_said_to_be_so(own):
    scene, _, motion = own
    turn = np.array([[np.cos(0.1), 0.0, np.sin(0.1)], [0.0, 1.0, 0.0], [-np.sin(0.1), 0.0, np.cos(0.1)]])
    moved = replace(motion, positions=motion.positions @ turn.T + [0.03, 0.0, 0.0])
    (hint,) = hints_of(scene, moved)
    assert (hint.code, "--fit-placement" in hint.text) == ("placement", True)


def test_held_vertices_that_stand_elsewhere_are_said_to_where_the_start_is_not_seen(own):
    scene, _, motion = own
    seen = np.ones(motion.positions.shape[:2], bool)
    seen[0] = False
    (hint,) = hints_of(scene, replace(motion, positions=motion.positions + [0.03, 0.0, 0.0], observed=seen))
    assert hint.code == "placement"
    assert "10 vertices that the scene holds stand 30" in hint.text  # mm, and 0.2 of noise


@pytest.mark.parametrize(("size", "shown"), [(1.05, "1.05 times"), (100.0, "100 times")])
def test_another_size_is_said(own, size, shown):
    scene, exact, _ = own
    motion = degrade(exact, 1e-5, observed=0.2, seed=1)  # little noise, as four digits are shown
    texts = {hint.code: hint.text for hint in hints_of(scene, replace(motion, positions=size * motion.positions))}
    assert shown in texts["scale"]
    assert "--fit-scale" in texts["scale"]


def test_edges_that_are_shorter_than_in_the_scene_are_said(own):
    scene, motion, _ = own
    shorter = motion.positions * np.where(np.arange(len(motion.times)) > 0, 0.7, 1.0)[:, None, None]
    texts = {hint.code: hint.text for hint in hints_of(scene, replace(motion, positions=shorter))}
    assert "shorter in the mean" in texts["rest_lengths"]
    codes = {hint.code for hint in hints_of(scene, replace(motion, positions=0.7 * motion.positions))}
    assert "scale" in codes  # from the beginning: a unit, and one remedy
    assert "rest_lengths" not in codes


def with_one_that_moves(x, times):
    x[:, 3, 0] += 0.05 * np.sin(10.0 * times)


def with_two_exchanged(x, _):
    x[6:, [44, 71]] = x[6:, [71, 44]]


@pytest.mark.parametrize(
    ("change", "code", "said"),
    [
        (with_one_that_moves, "held_vertices_move", ["1 vertex of 10", "vertex 3"]),
        (with_two_exchanged, "swapped_markers", [
            "objects[0] vertex 44 and objects[0] vertex 71 change places in frame 6",
        ]),
    ],
)  # fmt: skip
def test_vertices_that_move_though_they_are_held_or_change_places_are_named(own, change, code, said):
    scene, motion, _ = own
    x = motion.positions.copy()
    change(x, motion.times)
    (hint,) = hints_of(scene, replace(motion, positions=x))
    assert hint.code == code
    assert all(text in hint.text for text in said)


def test_equal_values_that_are_worse_than_the_scenes_own_are_said():
    scene = sheet(held="corners")
    count = len(scene.cloths[0].stiffness)
    uneven = with_parameters(sheet(held="corners", optimizationSettings="nL"), np.geomspace(2.0, 200.0, count))
    motion = simulate(uneven)
    flat = replace(uneven, cloths=tuple(replace(each, settings="nG") for each in uneven.cloths))
    found = estimate(flat, motion, intervals=False)
    assert found.rmse < 1e-6  # the scene's own values make the target itself, and are kept
    assert "pattern" in [hint.code for hint in found.hints]
    factor = replace(uneven, cloths=tuple(replace(each, settings="nF") for each in uneven.cloths))
    assert "pattern" not in [hint.code for hint in estimate(factor, motion, intervals=False).hints]


def test_a_start_with_another_step_is_named():
    scene = sheet()
    assert other_step(scene, None) == other_step(scene, 3.0) == other_step(scene, sheet(held=None)) == []
    (hint,) = other_step(scene, scene.with_step(scene.delta / 4, method="bdf2"))
    assert hint.before_fit
    assert "are for steps of 5 ms by bdf2, not of 20 ms by implicit" in hint.text
