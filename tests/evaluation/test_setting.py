"""The grid of settings: what is in it, and what it makes of a scene."""

import pytest
from helpers.physics import scene, thing

from clothfit.evaluation.setting import Setting, grid, own

pytestmark = pytest.mark.slow  # compiles a fit

POINT = thing([(0, 0, 0)])


@pytest.mark.parametrize("method", [0, 1, 2, 3])
@pytest.mark.parametrize("newton", [1, 3])
@pytest.mark.parametrize("tolerance", [1e-4, 1e-5, 9.999999747378752e-06])
def test_the_scenes_own_is_in_the_grid_once(method, newton, tolerance):
    one = scene(POINT, integrationMethod=method, forwardSubSteps=newton, tolerance=tolerance)
    assert grid(one).count(own(one)) == 1
    assert len(set(grid(one))) == len(grid(one))


def test_it_has_integrators_steps_tolerances_and_iterations():
    found = grid(scene(POINT))
    assert {s.integrator for s in found} == {"explicit", "symplectic", "implicit", "bdf2"}
    implicit = [s for s in found if s.integrator == "implicit"]
    assert {s.tolerance for s in implicit} == {1e-3, 1e-5, 1e-8}
    assert {s.newton for s in implicit} == {1, 2, 4}
    assert {1.0, 0.5, 0.25, 0.125} <= {s.ratio for s in implicit}
    second = [s for s in found if s.integrator == "bdf2"]
    assert {(s.ratio, s.tolerance) for s in second} == {(s.ratio, s.tolerance) for s in implicit}
    assert {s.newton for s in second} == {1}
    assert {1.0, 0.5, 0.25, 0.125} <= {s.ratio for s in found if s.integrator == "symplectic"}


def test_a_float32_1e_5_is_1e_5():
    found = grid(scene(POINT, tolerance=9.999999747378752e-06))
    assert {s.tolerance for s in found} == {None, 1e-3, 9.999999747378752e-06, 1e-8}


def test_applied_to_a_scene_it_changes_what_it_says_and_nothing_else():
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
