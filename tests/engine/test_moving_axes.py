"""A scene whose axes move: forces of inertia are those of the textbooks, and all derivatives stay exact."""

import numpy as np
import pytest
from helpers.fits import estimate
from helpers.physics import METHODS, ball, chain, keys, scene, sheet, thing, xyz
from helpers.scenes import document

from clothfit import InvalidInput, InvalidScene, energies, load, parameters, simulate
from clothfit.engine.inputs.sampling import winds
from clothfit.evaluation.forecast import inputs_of
from clothfit.motion.motion import in_scene, in_world
from clothfit.objective.objective import Objective
from clothfit.pictures.solids import solids

pytestmark = pytest.mark.slow
TIGHT = 1e-13
ZERO = (0.0, 0.0, 0.0)


def spin(rate, length):
    """A turn about y at a rate, rad/s: keys every 0.1 s, between which the axes turn evenly."""
    times = np.arange(0.0, length + 0.1, 0.1)
    return {"rotKeys": keys(times, [(0.0, np.degrees(rate) * t, 0.0) for t in times])}


def about_y(angle, x):
    """Points (n, 3) turned about y from z towards x."""
    c, s = np.cos(angle), np.sin(angle)
    return np.stack([c * x[:, 0] + s * x[:, 2], x[:, 1], -s * x[:, 0] + c * x[:, 2]], axis=1)


@pytest.mark.parametrize("method", METHODS)
def test_a_free_vertex_in_turning_axes_feels_coriolis_and_centrifugal_force_alone(method):
    """It goes straight on in the world: as the axes turn it takes a spiral in them."""
    h, rate, start, thrown = 0.01, 3.0, np.array([[0.4, 0.0, -0.2]]), np.array([0.5, 0.1, -0.3])
    made = scene(
        thing(start, vertVel=[xyz(thrown)]), integrationMethod=METHODS[method], delta=h, frame=spin(rate, 0.6),
        gravity=xyz(ZERO), optimizationIterations=51, tolerance=TIGHT,
    )  # fmt: skip
    motion = simulate(made)
    carried = (4 * about_y(rate * h, start) - about_y(2 * rate * h, start) - 3 * start) / (2 * h)
    np.testing.assert_allclose(carried, rate * np.array([[-0.2, 0.0, -0.4]]), rtol=2 * (rate * h) ** 2)  # ω × x
    for t, x in zip(motion.times, motion.positions, strict=True):
        # rounding of 50 steps
        np.testing.assert_allclose(x, about_y(-rate * t, start + t * (thrown + carried)), atol=1e-12)


@pytest.mark.parametrize("method", ["symplectic", "implicit", "bdf2"])  # explicit Euler leaves contacts too fast
def test_linear_acceleration_is_a_world_in_which_all_else_is_moved(method):
    path = keys([0, 0.07, 0.2], [ZERO, (0.03, 0.01, -0.02), (0.1, -0.05, 0.04)], interpolation="smooth")
    whole = {
        "integrationMethod": METHODS[method], "delta": 0.005, "optimizationIterations": 41, "tolerance": TIGHT,
        "windVel": xyz((3, 0, 2)), "windVelKeys": keys([0, 0.1], [ZERO, (1, 2, 0)]),
    }  # fmt: skip
    obstacle = ball((1.0, -0.7, 1.0), 0.65)
    box = {"type": 3, "pos": xyz((1, -1, 1)), "scale": xyz((1, 1, 1)), "friction": 0.3}
    cloth = {"dragCoefficient": 0.3, "damping": 0.05, "vertIsFixed": [i in (0, 2) for i in range(9)]}
    still = {"vertVel": [xyz(ZERO)] * 9}
    framed = scene(sheet("nn", **cloth, **still), frame={"posKeys": path}, colliders=[obstacle, box], **whole)
    first = in_world(simulate(framed, frames=3), framed).positions[:, 0]  # of a fixed vertex
    ride = xyz((4 * first[1] - first[2] - 3 * first[0]) / (2 * framed.delta))  # the velocity of the axes
    pins = [{"vertices": [0, 2], "posKeys": path}]
    moved = [{**each, "posKeys": path} for each in (obstacle, box)]
    world = scene(sheet("nn", **cloth, pins=pins, vertVel=[ride] * 9), colliders=moved, **whole)
    seen, true = simulate(framed), simulate(world)
    # of the same steps, but for the rounding of sums and what contacts make of it
    np.testing.assert_allclose(in_world(seen, framed).positions, true.positions, atol=1e-10)
    np.testing.assert_allclose(in_scene(true, framed).positions, seen.positions, atol=1e-10)
    np.testing.assert_allclose(energies(framed, seen).total, energies(world, true).total, atol=1e-8)


@pytest.mark.parametrize(("method", "order"), [("implicit", 1), ("bdf2", 2)])
def test_a_pendulum_on_a_centrifuge_hangs_where_weight_and_centrifugal_force_lead(method, order):
    """tan θ = ω² R/g, at the radius R of the bob; with smaller steps it stays there the better."""
    rate, arm, length = 4.0, 0.5, 0.4
    tilt = 0.6
    for _ in range(60):  # fixed-point iteration
        tilt = np.arctan(rate**2 * (arm + length * np.sin(tilt)) / 9.81)
    bob = np.array([arm + length * np.sin(tilt), -length * np.cos(tilt), 0.0])
    pull = 0.1 * 9.81 / np.cos(tilt)
    away = []
    for h in (0.01, 0.005):
        made = scene(
            thing([(arm, 0, 0), bob], [(0, 1)], fixed=(0,), stiffness=500.0, springRestLength=[length - pull / 500.0]),
            integrationMethod=METHODS[method], delta=h, frame=spin(rate, 1.0), tolerance=TIGHT,
            optimizationIterations=round(1.0 / h) + 1,
        )  # fmt: skip
        away.append(np.linalg.norm(simulate(made).positions[:, 1] - bob, axis=1).max())
    assert away[1] < 0.1 * length
    assert np.log2(away[0] / away[1]) == pytest.approx(order, abs=0.35)  # of errors with more than one power of h


def test_the_cost_is_the_distance_in_the_axes_of_the_scene_and_a_cloth_that_stays_there_has_not_travelled():
    one = sheet("LL", vertIsFixed=[i in (0, 1, 2) for i in range(9)])
    made = scene(one, frame=spin(5.0, 0.5), delta=0.01, optimizationIterations=6, tolerance=TIGHT)
    motion = simulate(made)
    shift = 0.01 * np.arange(6)
    objective = Objective(made, motion.positions + shift[:, None, None], TIGHT)
    assert objective.cost(parameters(made)) == pytest.approx(3 * 9 * (shift**2).sum(), rel=1e-9)
    still = np.broadcast_to(made.cloths[0].positions, motion.positions.shape)
    assert Objective(made, still, TIGHT).rms_displacement < 1e-12
    assert objective.rms_displacement > 0.01


@pytest.mark.parametrize("method", ["auto", "momentum"])
def test_a_fit_finds_stiffnesses_in_moving_axes(method):
    one = sheet("nL", vertIsFixed=[i in (0, 2) for i in range(9)], damping=0.1)
    made = scene(one, frame=spin(5.0, 0.5), delta=0.01, optimizationIterations=31, tolerance=TIGHT)
    target = simulate(made)
    guess = made.with_values([made.cloths[0].mass], [1.5 * made.cloths[0].stiffness])
    found = estimate(guess, target, method=method)
    assert found.rmse < 1e-8
    assert {hint.code for hint in found.hints} <= {"rest_lengths"}  # the sheet's are shorter; nothing of the axes
    shown = np.setdiff1d(np.arange(len(one["springStiffness"])), found.parameters[0].unidentifiable)
    np.testing.assert_allclose(found.scene.cloths[0].stiffness[shown], made.cloths[0].stiffness[shown], rtol=1e-5)


def test_what_needs_axes_that_stand_still_says_so():
    made = scene(chain(3, "nG"), frame=spin(1.0, 0.3))
    with pytest.raises(InvalidInput, match="frame: the axes of the scene must not move"):
        estimate(made, simulate(made), fit_time=True)
    with pytest.raises(InvalidInput, match="frame: a cost of one's own"):
        Objective(made, None, objective=lambda motion: (0.0, np.zeros_like(motion.positions)))


def test_the_wind_of_the_world_turns_in_the_axes_and_colliders_stay():
    box = {"type": 3, "pos": xyz((1, -1, 1)), "scale": xyz((1, 1, 1))}
    made = scene(chain(3, "nn"), frame=spin(2.0, 1.0), windVel=xyz((0, 0, 3)), colliders=[box])
    times = np.array([0.0, 0.5])
    np.testing.assert_allclose(winds(made, times), [[0, 0, 3], about_y(-1.0, np.array([[0, 0, 3.0]]))[0]], atol=1e-12)
    (shown,) = solids(made, times, made.cloths[0].positions)
    np.testing.assert_array_equal(shown.at(0), shown.at(1))


def test_the_keys_are_listed_and_faults_have_a_place():
    made = scene(chain(3, "nn"), frame=spin(2.0, 1.0))
    assert [each.place for each in inputs_of(made)] == ["frame.rotKeys"]
    for frame, place in [
        ({}, "frame: needs posKeys, rotKeys or both"),
        ({"posKeys": keys([1, 0], [ZERO, ZERO])}, r"frame.posKeys.times\[1\]"),
        ({"rotKeys": {"times": [0]}}, "frame.rotKeys: needs times and values, or a file"),
        ({"posKeys": 3}, "frame.posKeys"),
    ]:
        with pytest.raises(InvalidScene, match=place):
            load(document(frame=frame))
