"""The grid of settings; running one: what it is compared with, and when it is run at all."""

import gc

import numpy as np
import pytest
from helpers.physics import scene, thing
from helpers.scenes import cloth, document

import clothfit.scene.scene
from clothfit.evaluation import work_precision as precision
from clothfit.evaluation.reference import converged
from clothfit.evaluation.work_precision import Setting, Trial, expected, grid, judge, own, rerun, sampled, undisturbed

FALL = scene(thing([(0, 2, 0)]), thing([(0, 0, 0), (1, 0, 0)]), delta=0.1)
POINT = thing([(0, 0, 0)])


def made(name, ratio, steps, *seconds, newton=None):
    return Trial(Setting(name, ratio, None, newton), steps, "done", list(seconds))


@pytest.mark.parametrize("method", [0, 1, 2, 3])
@pytest.mark.parametrize(("newton", "tolerance"), [(1, 1e-5), (3, 1e-4), (3, 9.999999747378752e-06)])
def test_the_scenes_own_is_in_the_grid_once(method, newton, tolerance):
    one = scene(POINT, integrationMethod=method, forwardSubSteps=newton, tolerance=tolerance)
    assert grid(one).count(own(one)) == 1
    assert len(set(grid(one))) == len(grid(one))


def test_the_grid_has_integrators_steps_tolerances_and_iterations():
    found = grid(scene(POINT, tolerance=9.999999747378752e-06))  # 1e-5 as a float32
    names = "explicit", "symplectic", "implicit", "bdf2"
    kinds = {name: [s for s in found if s.integrator == name] for name in names}
    assert sum(map(len, kinds.values())) == len(found)
    assert {s.tolerance for s in found} == {None, 1e-3, 9.999999747378752e-06, 1e-8}
    assert {s.newton for s in kinds["implicit"]} == {1, 2, 4}
    assert {s.newton for s in kinds["bdf2"]} == {1}
    assert {1.0, 0.5, 0.25, 0.125} <= {s.ratio for s in kinds["implicit"]} & {s.ratio for s in kinds["symplectic"]}
    implicit, second = ({(s.ratio, s.tolerance) for s in kinds[name]} for name in ("implicit", "bdf2"))
    assert implicit == second


def test_applied_to_a_scene_a_setting_changes_what_it_says_and_nothing_else():
    one = scene(POINT, delta=0.02)
    made = Setting("symplectic", 0.25, None, None).applied(one)
    assert (made.method, made.delta, made.newton_iterations) == (1, 0.005, 1)
    assert made.cloths is one.cloths
    assert Setting("implicit", 2.0, 1e-3, 4).applied(one).newton_iterations == 4
    assert own(one).applied(one).delta == one.delta


@pytest.mark.parametrize(("ratio", "steps", "name"), [(4.0, 3, "4 h"), (1.0, 10, "h"), (0.125, 80, "h/8")])
def test_its_steps_reach_the_last_frame(ratio, steps, name):
    setting = Setting("implicit", ratio, 1e-5, 1)
    assert (setting.steps(11), setting.step_name) == (steps, name)


@pytest.mark.parametrize("ratio", [1.0, 0.25, 2.0, 4.0])
def test_frames_are_taken_at_their_times(ratio):
    steps = Setting("implicit", ratio, None, 1).steps(8)
    x = np.zeros((steps + 1, 2, 3))
    x[:, 1, 2] = 5.0 + ratio * np.arange(steps + 1)  # one unit a frame
    np.testing.assert_array_equal(sampled(x, ratio, 8)[:, 1, 2], 5.0 + np.arange(8))
    assert not sampled(x, ratio, 8)[:, 0].any()


@pytest.mark.slow  # compiles
@pytest.mark.parametrize(("name", "sign"), [("explicit", 1.0), ("symplectic", -1.0), ("implicit", -1.0)])
@pytest.mark.parametrize("ratio", [1.0, 0.25])
def test_in_free_fall_every_integrator_is_off_by_h_g_t_over_2(name, sign, ratio):
    t = 0.1 * np.arange(11)
    fallen = np.outer(9.81 * t**2 / 2, (0.0, 1.0, 0.0))[:, None]
    exact = np.array([(0.0, 2.0, 0.0), (0.0, 0.0, 0.0), (1.0, 0.0, 0.0)]) - fallen
    run_of = Trial(Setting(name, ratio, 1e-8, 1), Setting(name, ratio, 1e-8, 1).steps(11))
    judge(FALL, run_of, exact)
    gap = sign * 0.1 * ratio * 9.81 * t / 2
    np.testing.assert_allclose(run_of.squares, gap**2, atol=1e-13)  # rounding of metres, times a gap of up to 1 m
    np.testing.assert_allclose(run_of.largest, np.abs(gap), atol=1e-13)
    assert (run_of.status, len(run_of.seconds)) == ("done", 1)


@pytest.mark.slow  # compiles
@pytest.mark.parametrize(
    ("name", "newton"), [("explicit", None), ("symplectic", None), ("implicit", 1), ("implicit", 2)]
)
def test_all_integrators_approach_the_reference_at_order_1(name, newton):
    heavy = cloth(vertMass=[0.1] * 12, damping=0.4, dragCoefficient=0.2)
    one = clothfit.scene.scene.load(document(heavy, delta=0.01, windVel={"x": 2.0, "y": 0.0, "z": 1.0}))
    reference = converged(one, 31, error=1e-7)
    errors = []
    for ratio in (1 / 8, 1 / 16, 1 / 32):
        setting = Setting(name, ratio, 1e-10, newton)
        run_of = Trial(setting, setting.steps(31))
        judge(one, run_of, reference.positions)
        errors.append(np.sqrt(run_of.squares.mean()))
    # the next term is smaller by the factor h ω, 0.06 at the shortest steps (ω ≈ √(4 · 57/0.1)/s)
    np.testing.assert_allclose(np.log2(np.array(errors[:-1]) / errors[1:]), 1, atol=0.1)
    assert reference.error < 1e-3 * errors[-1]


@pytest.mark.slow  # compiles
@pytest.mark.filterwarnings("ignore:overflow", "ignore:invalid")  # as plain Python
def test_what_diverges_says_so():
    stiff = scene(thing([(0, 0, 0), (1, 0, 0)], [(0, 1)], stiffness=1e7, fixed=(0,)), delta=0.1)
    run_of = Trial(Setting("symplectic", 1.0, None, None), 30)
    judge(stiff, run_of, np.zeros((31, 2, 3)))
    assert (run_of.status, run_of.squares, run_of.seconds) == ("diverged", None, [])


def test_what_a_run_will_take_is_known_by_its_kind():
    before = [
        made("implicit", 4.0, 10, 1.0, newton=1),
        made("implicit", 2.0, 20, 1.6, 99.0, newton=1),
        made("implicit", 4.0, 10, 5.0, newton=2),
        made("explicit", 1.0, 40, 0.4),
    ]
    assert expected(made("implicit", 1.0, 40, newton=1), before) == pytest.approx(3.2)  # 0.08 s a step
    assert expected(made("implicit", 4.0, 10, newton=4), before) == pytest.approx(5.0)  # as the dearest
    assert expected(made("symplectic", 0.5, 80), before) == pytest.approx(0.8)  # as the cheapest
    assert expected(made("symplectic", 0.5, 80), []) == 0.0


def test_runs_go_round_until_each_has_its_number(monkeypatch):
    order = []

    def run(scene, setting, steps):
        order.append(setting.integrator)
        return 0.1, []

    monkeypatch.setattr(precision, "run", run)
    trials = [made("explicit", 1.0, 1, 0.1), made("implicit", 1.0, 1, 0.1, newton=1)]
    assert list(rerun(FALL, trials, np.inf)) == list(range(2, precision.TIMED_RUNS + 1))
    assert order == ["explicit", "implicit"] * (precision.TIMED_RUNS - 1)
    assert [len(t.seconds) for t in trials] == [precision.TIMED_RUNS, precision.TIMED_RUNS]
    assert list(rerun(FALL, trials, -np.inf)) == list(range(2, precision.TIMED_RUNS + 1))
    assert len(order) == 2 * (precision.TIMED_RUNS - 1)  # no time was left for more


def test_the_garbage_collector_is_off_and_on_again():
    with pytest.raises(ZeroDivisionError), undisturbed():
        assert not gc.isenabled()
        1 / 0  # noqa: B018
    assert gc.isenabled()


def test_cheap_ones_come_first():
    trials = [made("implicit", 1.0, 10, newton=4), made("implicit", 1.0, 10, newton=1), made("explicit", 0.5, 20)]
    assert sorted(trials, key=lambda t: t.effort) == trials[::-1]


def test_it_knows_what_it_keeps():
    # 11 states of 2 vertices, each with a position and 4 velocities of 3 numbers
    assert Trial(Setting("implicit", 1.0, 1e-5, 4), 10).needs(FALL) == 11 * 2 * 5 * 24
