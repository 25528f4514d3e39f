"""Several targets: their costs add up, each with its own scene, and together they show more than one."""

import numpy as np
import pytest
from helpers.costs import simulate_all
from helpers.fits import estimate
from helpers.physics import scene, xyz
from helpers.scenes import cloth, even, sphere, trial

from clothfit import InvalidInput, InvalidMotion, load, parameters, simulate, with_parameters
from clothfit.derivative.verify import check
from clothfit.fit.estimate import record_target
from clothfit.objective.experiment import experiments
from clothfit.objective.objective import Objective

pytestmark = pytest.mark.slow

MAIN = load(even("LG"))
MAIN_MASS, ONE_SPRING = MAIN.blocks[0], cloth(4, 4, springs=[0, 1], springStiffness=[1.0])
WINDY = load(even("nn", 30, delta=0.01, windVel=xyz((2, 0, 1)), vertIsFixed=[i in (0, 12) for i in range(16)]))


def hidden_masses(objective):
    """The masses of the main cloth that no target reveals."""
    return np.flatnonzero(~objective.identifiable[MAIN_MASS.part]).tolist()


def truth(made, factor=1.2):
    """The motion of other values than the scene's."""
    flagged = experiments(MAIN, (record_target(made), made))[0].scene
    return simulate(with_parameters(flagged, factor * parameters(flagged)), tolerance=1e-14)


def test_the_cost_is_the_sum_of_the_costs():
    one, two = truth(MAIN), truth(WINDY)
    p = parameters(MAIN)
    both = Objective(MAIN, [one, (two, WINDY)])
    apart = [Objective(MAIN, one), Objective(MAIN, (two, WINDY))]
    values, gradients = zip(*(objective.cost_and_gradient(p) for objective in apart), strict=True)
    value, gradient = both.cost_and_gradient(p)
    assert value == both.cost(p) == both.cost_or_infinity(p, 0) == sum(values)
    np.testing.assert_allclose(gradient, sum(gradients), rtol=1e-13)  # another order of summation
    assert (both.frames, both.observations) == (50, 50 * 16)
    assert min(values) > 0


def test_the_gradient_with_several_experiments():
    objective = Objective(MAIN, [truth(MAIN), (truth(WINDY), WINDY), truth(MAIN, 0.9)])
    assert check(objective, parameters(MAIN), seed=3).passed
    assert len(objective.runs) == 3


def test_each_experiment_has_its_own_forces_and_the_same_parameters():
    p = 1.3 * parameters(MAIN)
    objective = Objective(MAIN, (truth(WINDY), WINDY))
    (run,) = objective.runs
    flagged = experiments(MAIN, (truth(WINDY), WINDY))[0].scene
    expected = simulate(with_parameters(flagged, p), tolerance=1e-14)
    np.testing.assert_array_equal(simulate_all(objective, run, p)[1].x, expected.positions)
    np.testing.assert_array_equal(run.changed(p).vertex.mass, p[:16])


def test_what_is_not_flagged_is_the_experiments_own():
    heavy = load(even("nn", vertMass=[0.05] * 16))
    made = load(even("nG"))
    objective = Objective(made, (record_target(heavy), heavy))
    assert objective.runs[0].changed(np.array([7.0])).vertex.mass.tolist() == [0.05] * 16
    assert objective.runs[0].changed(np.array([7.0])).springs.stiffness.tolist() == [7.0] * 33


def test_what_one_experiment_cannot_show_another_can():
    # the corners are fixed in the main scene, others in the windy one
    one, two = truth(MAIN), truth(WINDY)
    assert hidden_masses(Objective(MAIN, one)) == [0, 3]
    assert hidden_masses(Objective(MAIN, (two, WINDY))) == [0, 12]
    both = Objective(MAIN, [one, (two, WINDY)])
    assert hidden_masses(both) == [0]
    assert np.flatnonzero(~both.identifiable).tolist() == [0]


def test_a_fit_to_two_experiments_finds_what_both_share():
    made = load(even("GG"))
    goals = [record_target(made), (record_target(WINDY), WINDY)]
    found = estimate(made, goals, start=[0.03, 20.0], method="l-bfgs-b")
    assert (found.status, found.frames) == ("converged", 50)
    np.testing.assert_allclose(parameters(found.scene), [0.02, 30.0], rtol=1e-4)  # RMSE below 1e-8 m


def test_each_experiment_is_compared_as_far_as_its_scene_says():
    short = load(even("nn", 8))
    found = estimate(load(even("nG")), [record_target(MAIN, 60), (record_target(short, 60), short)], max_evaluations=1)
    assert found.frames == 20 + 8


@pytest.mark.parametrize(
    ("targets", "error", "message"),
    [
        (list, InvalidInput, "target: none is given"),
        (lambda: (record_target(WINDY), load(even("nn", nx=5))), InvalidInput, r"its objects have .* those of scene"),
        (lambda: [record_target(MAIN), np.zeros((3, 5, 3))], InvalidMotion, r"positions: has shape \(3, 5, 3\)"),
        (lambda: (record_target(load(trial("nn", nx=3))), WINDY), InvalidMotion, "its objects have"),
        (lambda: (record_target(MAIN), scene(ONE_SPRING)), InvalidInput, "16 vertices and 1 spring, "),
    ],
)
def test_targets_that_do_not_fit_are_refused(targets, error, message):
    with pytest.raises(error, match=message):
        Objective(MAIN, targets())


def test_the_scenes_need_as_many_colliders_and_keys_where_these_are_fitted():
    one, two, none = ([sphere(friction=0.2)] * count for count in (1, 2, 0))
    keyed = {"times": [0, 1], "values": [xyz((0, 0, 0)), xyz((1, 0, 0))]}
    main = scene(cloth(), colliders=one, windVelKeys=keyed, fit={"friction": "G", "windVelKeys": "L"})
    still = np.tile(main.cloths[0].positions, (2, 1, 1))
    assert experiments(main, (still, scene(cloth(), colliders=one, windVelKeys=keyed)))[0].scene.mode("friction") == "G"
    for other in (two, none):
        with pytest.raises(InvalidInput, match=rf"^scene: friction: {len(other)} in this scene, 1 in scene; "):
            experiments(main, (still, scene(cloth(), colliders=other, windVelKeys=keyed)))
    with pytest.raises(InvalidInput, match=r"^scene: wind over time: 0 in this scene, 2 in scene; "):
        experiments(main, (still, scene(cloth(), colliders=one)))
    with pytest.raises(InvalidInput, match=r"^scene: the scene has 2 values of friction, 1 are needed$"):
        parameters(scene(cloth(), colliders=two, windVelKeys=keyed), flags=main)
