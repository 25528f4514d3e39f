"""An objective over fewer frames, and what it says of how far its target moves."""

import numpy as np
import pytest
from helpers.physics import TIGHT
from helpers.scenes import even, trial

from clothfit.motion.degrade import degrade
from clothfit.motion.motion import Motion
from clothfit.motion.simulate import simulate
from clothfit.objective.objective import Objective
from clothfit.scene.fit_vector import parameters
from clothfit.scene.scene import load

pytestmark = pytest.mark.slow  # compiles a fit

SCENE = load(trial("nL", 12, 3, 3))
MOTION = simulate(SCENE, tolerance=TIGHT)
P = 1.3 * parameters(SCENE)


@pytest.mark.parametrize("frames", [1, 2, 5, 12, 99])
def test_fewer_frames_cost_what_these_cost(frames):
    aim = Objective(SCENE, MOTION, TIGHT)
    part = aim.until(frames)
    x = simulate(load(trial("nL", 12, 3, 3, springStiffness=P.tolist())), tolerance=TIGHT).positions
    expected = ((x - MOTION.positions)[:frames] ** 2).sum()
    assert part.cost(P) == pytest.approx(expected, rel=1e-9, abs=1e-25)  # solves to 1e-14; nothing at the start
    assert part.frames == min(frames, 12)
    assert part.steps == min(frames, 12) - 1
    assert part.tolerance == aim.tolerance


def test_costs_of_positions_add_up_over_frames():
    aim = Objective(SCENE, MOTION, TIGHT)
    costs = [aim.until(frames).cost(P) for frames in range(2, 13)]
    assert (np.diff(costs) > 0).all()
    assert costs[-1] == aim.cost(P)


def test_the_rest_of_what_was_asked_stays():
    options = {"objective": {"position": 1.0, "velocity": 0.01}, "loss": "huber", "loss_scale": 0.02}
    part = Objective(SCENE, degrade(MOTION, observed=0.7), TIGHT, 9, **options).until(6, 1e-6)
    same = Objective(SCENE, degrade(MOTION, observed=0.7), 1e-6, 6, **options)
    assert part.tolerance == 1e-6
    assert part.cost(P) == same.cost(P)
    assert Objective(SCENE, MOTION, TIGHT, 5).until(8).steps == 4  # no more than there was


def test_each_experiment_has_its_own_end():
    longer = load(trial("nL", 20, 3, 3))
    aim = Objective(SCENE, [MOTION, (simulate(longer), longer)], TIGHT, [6, 20])
    assert aim.steps == 19
    assert [run.comparison.last_step for run in aim.until(10).runs] == [5, 9]


def test_still_is_the_cost_of_a_cloth_that_does_not_move():
    aim = Objective(SCENE, MOTION, TIGHT)
    assert aim.still == pytest.approx(((MOTION.positions - SCENE.cloths[0].positions) ** 2).sum(), rel=1e-12)
    resting = Motion(np.array([SCENE.cloths[0].positions] * 12), MOTION.times, MOTION.vertex_counts)
    assert Objective(SCENE, resting).still == 0.0


def test_the_first_step_is_the_first_at_which_anything_is_seen():
    made = load(even("nG", 20))
    motion = simulate(made)
    assert Objective(made, motion).first_step == 1
    late = Motion(motion.positions[7:], motion.times[7:] + 0.005, motion.vertex_counts)
    assert Objective(made, late).first_step == 8  # between the steps 7 and 8
    assert Objective(made, motion).until(1).first_step == 0
