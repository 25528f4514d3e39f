"""The time step of a fit: what it predicts, which frames it compares, and which step it chooses."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.strangers import small, with_finer_steps

from clothfit.engine.system import BDF2, IMPLICIT
from clothfit.fit.continuation import frame_interval, last_time, with_interval, with_substeps
from clothfit.fit.step_choice import COUNTS, Trial, chosen, finer
from clothfit.motion.degrade import degrade
from clothfit.motion.motion import at_frames
from clothfit.motion.simulate import simulate
from clothfit.objective.experiment import Experiment
from clothfit.objective.objective import Objective
from clothfit.optimise.search import Search
from clothfit.scene.fit_vector import parameters

pytestmark = pytest.mark.slow

ENOUGH = 1e-8  # m, as in a fit


# --- an objective with other steps


def objective(scene, motion, **options):
    """The objective of a fit, over the scene's frames."""
    return Objective(scene, motion, 1e-10, scene.frames, **options)


@pytest.mark.parametrize("part", [slice(None), slice(None, None, 3), slice(0, 1)], ids=str)
def test_the_frames_of_a_target_and_their_steps(part):
    scene = small("nF", 13)
    given = Experiment(at_frames(simulate(scene), part), scene)
    assert frame_interval(given) == (part.step or 1) * scene.delta  # though times differ by their rounding
    assert last_time(given) == pytest.approx(0.0 if part.stop else 12 * scene.delta)


@pytest.mark.parametrize("fps", [24.0, 50.0, 120.0])
@pytest.mark.parametrize("offset", [0.0, 0.0117])
@pytest.mark.parametrize("count", [1, 3])
def test_other_steps_compare_the_same_frames(fps, offset, count):
    scene = small("nF", 31)
    times = offset + np.arange(80) / fps
    motion = replace(simulate(scene, 80), times=times)
    before = objective(scene, motion)
    after = with_substeps(before, count, BDF2)
    (given,) = after.experiments
    assert after.frames == before.frames == (times <= 30 * scene.delta + 1e-9).sum()
    assert given.scene is after.scene
    assert after.scene.delta == pytest.approx(1.0 / fps / count)
    # over the same time, but for less than a step
    assert abs((after.scene.frames - 1) * after.scene.delta - 30 * scene.delta) < after.scene.delta
    assert last_time(given) == pytest.approx(last_time(before.experiments[0]))


@pytest.mark.parametrize("method", [None, IMPLICIT, BDF2])
def test_a_target_by_finer_steps_is_met_by_them(method):
    scene = small("nF", 9, method=BDF2 if method is None else IMPLICIT)
    used = scene.method if method is None else method
    fine = scene.with_step(scene.delta / 4, 4 * 8 + 1, used)
    motion = at_frames(simulate(fine, tolerance=1e-12), slice(None, None, 4))
    found = with_substeps(objective(scene, motion), 4, method)
    assert found.scene.method == used
    assert found.rmse(found.cost(parameters(scene))) < 1e-9  # m; systems are solved to 1e-10
    assert objective(scene, motion).rmse(objective(scene, motion).cost(parameters(scene))) > 1e-3


def test_each_target_has_steps_of_its_own():
    main, other = small("nF", 13), small("nF", 7, delta=0.04, windVel={"x": 1.0, "y": 0.0, "z": 0.0})
    before = Objective(main, [simulate(main), (simulate(other), other)], 1e-10, [13, 7])
    after = with_substeps(before, 2, BDF2)
    first, second = (each.scene for each in after.experiments)
    assert (first.delta, second.delta) == (pytest.approx(0.01), pytest.approx(0.02))
    assert (first.frames, second.frames) == (25, 13)
    assert second.wind.tolist() == [1.0, 0.0, 0.0]
    assert after.frames == before.frames == 20


def test_steps_that_reach_a_time_are_not_too_few():
    scene = small("nF", 11)  # 0.2 s
    for delta, last, frames in ((0.03, 0.0, 7), (0.03, 0.19, 8), (0.05, 0.0, 5), (1.0, 0.0, 2)):  # the first: 0.18 s
        assert with_interval(scene, delta, None, last).frames == frames


# --- the choice


@pytest.mark.parametrize("method", [IMPLICIT, BDF2])
def test_a_target_by_finer_steps_is_fitted_by_finer_steps(method):
    scene = small("nF", 24, method=method)
    goal = objective(scene, with_finer_steps(scene, 8))
    found = chosen(Search(goal, parameters(scene), ENOUGH, 10**4), COUNTS)
    count, used = found.step
    assert count > 1
    assert found.objective.scene.method == used == BDF2
    assert found.objective.scene.delta == pytest.approx(scene.delta / count)
    errors = [each.rmse for each in found.tried]
    assert found.objective.rmse(found.cost) in errors
    assert found.objective.rmse(found.cost) < 0.1 * errors[0]  # second order against first
    assert found.objective.cost(found.p) == pytest.approx(found.cost, rel=1e-6)
    tried = [(each.substeps, each.integrator) for each in found.tried[:3]]
    assert tried == [(1, "implicit"), (2, "implicit"), (1, "bdf2")]
    assert all(each.seconds >= 0 for each in found.tried)


@pytest.mark.parametrize("method", [IMPLICIT, BDF2])
@pytest.mark.parametrize("noise", [0.0, 1e-3])
def test_a_target_by_the_scenes_own_step_keeps_it(method, noise):
    scene = small("nF", 24, method=method)
    goal = objective(scene, degrade(simulate(scene, tolerance=1e-12), noise=noise, seed=1))
    found = chosen(Search(goal, 1.3 * parameters(scene), ENOUGH, 10**4), COUNTS)
    assert (found.step, len(found.tried), found.leaves_noise) == (None, 1, True)
    assert found.objective is goal
    assert found.cost <= goal.cost(parameters(scene)) + 1e-12  # m²; the truth of one value is found


def test_finer_steps_end_where_they_stop_to_pay():
    scene = small("nF", 24, method=BDF2)
    bent = with_finer_steps(small("nF", 24, method=BDF2, damping=0.5, dragCoefficient=0.5), 8)  # another model
    found = chosen(Search(objective(scene, bent), parameters(scene), ENOUGH, 10**4), COUNTS)
    assert not found.leaves_noise
    assert max(each.substeps for each in found.tried) < max(COUNTS)
    assert found.objective.rmse(found.cost) <= 1.05 * min(each.rmse for each in found.tried)


def test_a_trial_whose_equations_have_no_solution_ends_alone():
    """As one that diverges: a motion far beyond its target may have an exactly singular step."""
    scene = small("nF", 24)
    search = Search(objective(scene, simulate(scene)), 1.3 * parameters(scene), ENOUGH, 10**4)

    def singular(own):
        own.visit(own.start)
        np.linalg.inv(np.zeros((1, 1)))

    trial = Trial(search)
    trial.run(singular)
    assert np.isfinite(search.best.cost)
    assert not trial.ended


# --- a look at finer steps


def test_a_look_sees_what_finer_steps_gain_and_nothing_at_the_own_motion():
    scene = small("nF", 24)
    p, coarse = parameters(scene), objective(scene, with_finer_steps(scene, 8))
    assert finer(coarse, p) < 0.1 * coarse.rmse(coarse.cost(p))  # second order against first
    motion = degrade(simulate(scene, tolerance=1e-12), noise=1e-3, seed=1)
    assert finer(objective(scene, motion), p) is None
