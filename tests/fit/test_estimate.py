"""The fit as a whole: what it recovers, what it may not know, what it keeps, how it ends."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from helpers.fits import Watching, estimate
from helpers.physics import xyz
from helpers.scenes import changed, cloth, document, even, trial

from clothfit import Diverged, InvalidInput, InvalidMotion, Motion, degrade, simulate
from clothfit.base import interrupts
from clothfit.base.limits import FIT_TOLERANCE
from clothfit.fit.estimate import record_target
from clothfit.fit.options import OWN_METHODS, RMSE_TOLERANCE
from clothfit.objective.identifiability import identifiable
from clothfit.objective.objective import Objective, cost_and_gradient
from clothfit.optimise.scipy_methods import FREE, METHODS
from clothfit.scene.fit_vector import LOWER, UPPER, parameters, with_parameters
from clothfit.scene.scene import load

pytestmark = pytest.mark.slow

ALONE = ("auto", "momentum")
BOUNDED = {"bounds": {"stiffness": [LOWER, UPPER]}}
UNSTABLE_ABOVE = 50.0  # N/m: explicit steps of `unstable` explode at a stiffness of 100, not at its own 30


def unstable(settings="nG"):
    """A scene whose explicit steps diverge for the stiffer half of the parameters' range."""
    return load(even(settings, 60, integrationMethod=0, delta=0.004))


def value_of(scene, start):
    """The cost of one value for all parameters against the scene's own motion."""
    return Objective(scene, record_target(scene), 1e-10).cost(np.full(len(parameters(scene)), start))


@pytest.fixture
def costs(monkeypatch):
    """Every cost that is evaluated during a test."""
    seen = []
    original = Objective.cost_and_gradient

    def spy(self, p):
        cost, gradient = original(self, p)
        seen.append(cost)
        return cost, gradient

    monkeypatch.setattr(Objective, "cost_and_gradient", spy)
    return seen


# --- what it recovers


@pytest.mark.parametrize(
    ("settings", "make", "method"),
    [("Gn", even, "auto"), ("nG", even, "auto"), ("GG", even, "auto"), *product(["Ln", "nL", "LL"], [trial], ALONE)],
)
def test_the_hidden_truth_is_found(settings, make, method):
    scene = load(make(settings))
    found = estimate(scene, method=method)
    assert (found.status, found.method, found.frames) == ("converged", method, 20)
    assert found.evaluations == 1 or make is even  # the balances of an exact target need no simulation but one
    assert found.rmse <= RMSE_TOLERANCE
    # Independent of the fit's own bookkeeping; 1e-7: the scene's motion is solved to 1e-10 relative, of metres.
    gap = simulate(found.scene, tolerance=1e-10).positions - simulate(scene, tolerance=1e-10).positions
    assert np.sqrt((gap**2).sum(axis=2).mean()) < 1e-7
    kept = identifiable(scene)
    # 1e-4: what the worst seen parameter moves the cloth by at 1e-8 m, 20 frames of metres and a sensitivity of 1e-3.
    rtol = 1e-4 if make is even else 1e-5  # as in test_momentum
    np.testing.assert_allclose(parameters(found.scene)[kept], parameters(scene)[kept], rtol=rtol)


def test_both_flagged_objects_are_found_each_by_its_own():
    first = even("nG")["objects"][0]
    second = changed(changed(first, ("springStiffness",), [90.0] * 33), ("optimizationSettings",), "Gn")
    scene = load(document(first, second, optimizationIterations=20))
    found = estimate(scene)
    np.testing.assert_allclose(parameters(found.scene), [30.0, 0.02], rtol=1e-4)  # as above
    assert [(block.object, block.name, block.mode, block.count) for block in found.parameters] == [
        (0, "stiffness", "G", 1),
        (1, "mass", "G", 1),
    ]


def test_only_the_flagged_object_is_moved():
    wild = cloth(3, 3, springStiffness=[1e9] * 16, optimizationSettings="nn")
    scene = load(document(wild, even("nG")["objects"][0], optimizationIterations=60, integrationMethod=0, delta=0.004))
    with pytest.raises(Diverged):
        simulate(scene)
    found = estimate(scene)
    assert found.status == "converged"
    np.testing.assert_allclose(parameters(found.scene), 30.0, rtol=1e-4)  # as above
    assert found.scene.cloths[0].stiffness.tolist() == [1e9] * 16


@pytest.mark.parametrize(
    ("degraded", "rtol"),
    [*((gaps, 1e-4) for gaps in ({"observed": 0.5}, {"every": 2}, {"observed": 0.4, "every": 3, "seed": 5})),
     ({"noise": 1e-4, "seed": 1}, 0.1)],  # as above; noise 1e-4 of a motion of 0.1 m
)  # fmt: skip
def test_a_target_with_gaps_is_enough_and_a_noisy_one_is_fitted_down_to_the_noise(degraded, rtol):
    scene = load(even("GG"))
    target = degrade(record_target(scene), **degraded)
    found = estimate(scene, target, start=1.0)
    assert (found.status, found.frames) == ("converged", len(target.times))
    np.testing.assert_allclose(parameters(found.scene), [0.02, 30.0], rtol=rtol)
    if noise := degraded.get("noise"):
        # The minimum lies below the truth's cost. 1.05: the mean of 960 squares scatters by sqrt(2 / 960) = 4.6 %, its
        # root by half of that.
        assert found.cost <= Objective(scene, target, 1e-10).cost(parameters(scene))
        assert noise * np.sqrt(3) / 1.05 < found.rmse < noise * np.sqrt(3) * 1.05


def test_a_longer_target_is_compared_only_as_far_as_the_scene_says():
    scene = load(even("nG", 20))
    target = record_target(scene, 40)
    target.positions[20:] += 1.0
    found = estimate(scene, target, start=10.0)
    assert (found.status, found.frames) == ("converged", 20)


# --- what it may not know


@pytest.mark.parametrize("settings", ["Ln", "nG", "LL"])
def test_hidden_values_are_known_through_the_target_only(settings):
    scene = load(trial(settings))
    target = record_target(scene)
    other = with_parameters(scene, 3.0 * parameters(scene) + 0.5)
    first, second = (estimate(s, target, start=0.7, max_evaluations=15) for s in (scene, other))
    np.testing.assert_array_equal(parameters(first.scene), parameters(second.scene))
    assert (first.cost, first.status, first.evaluations) == (second.cost, second.status, second.evaluations)


# --- where it starts


STARTS = {
    "number": 60.0, "integer": 60, "one": [60.0], "array": np.full(33, 60.0), "list": [60.0] * 33,
    "scene": load(even("nL", springStiffness=[60.0] * 33)),
    "other flags": load(even("Gn", springStiffness=[60.0] * 33)),
}  # fmt: skip


@pytest.mark.parametrize("kind", STARTS)
def test_every_kind_of_start(kind):
    scene = load(even("nL"))
    found = estimate(scene, start=STARTS[kind], method="l-bfgs-b", max_evaluations=1)  # which begins at the start
    # Of the start nothing but the rounding of log and exp may be lost before the first evaluation.
    np.testing.assert_allclose(parameters(found.scene), 60.0, rtol=1e-14)
    assert found.cost == pytest.approx(value_of(scene, 60.0), rel=1e-10)


@pytest.mark.parametrize("method", ["l-bfgs-b", "gauss-newton"])
def test_with_a_target_it_starts_from_the_scenes_own_values_and_without_one_it_does_not(method):
    scene = load(trial("LG"))
    found = estimate(scene, record_target(load(even("nn"))), method=method, max_evaluations=1)
    np.testing.assert_allclose(parameters(found.scene), parameters(scene), rtol=1e-14)  # rounding of log and exp
    found = estimate(scene, method=method, max_evaluations=1)
    kept = identifiable(scene)
    assert np.abs(np.log(parameters(found.scene) / parameters(scene)))[kept].min() > 1e-3
    np.testing.assert_array_equal(parameters(found.scene)[~kept], parameters(scene)[~kept])  # no motion can tell them
    assert found.cost > 0


def test_a_start_outside_of_the_bounds_taken_from_a_scene_is_moved_to_them_and_named():
    scene = load(even("nG", springStiffness=[1e5] * 33, fit=BOUNDED))
    found = estimate(scene, record_target(load(even("nn"))))
    np.testing.assert_allclose(parameters(found.scene), 30.0, rtol=1e-4)  # as above
    assert found.warnings == [
        "objects[0] stiffness: 1 of 1 starting values lie outside the bounds 0.0001 … 10000 and start at the bound; "
        "the truth may lie outside as well"
    ]


# --- methods


@pytest.mark.parametrize("settings", ["Gn", "GG"])
@pytest.mark.parametrize("method", [*OWN_METHODS, *METHODS])
def test_every_method_reduces_the_cost(costs, method, settings):
    scene = load(even(settings, 10, 3, 3))
    found = estimate(scene, start=3.0, method=method, max_evaluations=60)
    assert found.method == method
    assert found.evaluations <= 60
    assert found.cost < 0.5 * value_of(scene, 3.0)  # far less than any of them does, far more than rounding
    assert method in OWN_METHODS or found.cost == min(costs)
    # The cost belongs to the scene that is returned; 1e-9: the same linear systems, up to log and exp of the values.
    p = parameters(found.scene)
    assert Objective(scene, record_target(scene), 1e-10).cost(p) == pytest.approx(found.cost, rel=1e-9)
    assert ((p >= LOWER) & (p <= UPPER)).all()


@pytest.mark.parametrize("method", [name for name in METHODS if name not in FREE])
def test_methods_with_bounds_find_one_value(method):
    found = estimate(load(even("Gn", 10, 3, 3)), start=3.0, method=method)
    np.testing.assert_allclose(parameters(found.scene), 0.02, rtol=1e-3)  # some of them end on tolerances of their own


# --- what it keeps, what it says


def test_what_no_motion_reveals_keeps_its_start_and_is_listed():
    scene = load(trial("LL", vertIsFixed=[i < 4 for i in range(16)]))
    start = np.linspace(0.01, 0.05, 16).tolist() + np.linspace(10.0, 40.0, 33).tolist()
    found = estimate(scene, start=start, max_evaluations=10)
    lost = [s for s, ends in enumerate(scene.cloths[0].springs.tolist()) if max(ends) < 4]
    assert [block.unidentifiable for block in found.parameters] == [[0, 1, 2, 3], lost]
    assert len(lost) == 3
    kept = [*range(4), *(16 + s for s in lost)]
    p = parameters(found.scene)
    assert p[kept].tolist() == np.array(start)[kept].tolist()
    assert (np.delete(p, kept) != np.delete(start, kept)).all()


@pytest.mark.parametrize("settings", ["GG", "LL"])
def test_a_cloth_that_cannot_move_has_nothing_to_find_and_keeps_its_values(settings):
    scene = load(trial(settings, vertIsFixed=[True] * 16))
    kept = estimate(scene, record_target(scene)).scene
    np.testing.assert_array_equal(kept.cloths[0].mass, scene.cloths[0].mass)
    found = estimate(scene, start=7.0)
    assert [len(block.unidentifiable) for block in found.parameters] == [block.count for block in found.parameters]
    assert [block.at_bound for block in found.parameters] == [[] for _ in found.parameters]
    assert (parameters(found.scene) == 7.0).all()
    assert found.cost == 0.0


@pytest.mark.parametrize("method", ["l-bfgs-b", "powell", "slsqp", "cobyla"])
@pytest.mark.parametrize("budget", [1, 7])
def test_a_spent_budget_gives_the_best_point(costs, method, budget):
    found = estimate(load(trial("LL")), start=1.0, method=method, max_evaluations=budget)
    assert (found.status, found.evaluations, len(costs)) == ("limit", budget, budget)
    assert found.cost == min(costs)


@pytest.mark.parametrize("method", METHODS)
def test_an_interrupt_gives_the_best_so_far(costs, method):
    def interrupt(progress):
        assert progress.evaluations <= 4
        if progress.evaluations == 4:
            raise KeyboardInterrupt

    found = estimate(load(even("GG", 10, 3, 3)), start=3.0, method=method, observer=Watching(progress=interrupt))
    assert (found.status, found.evaluations) == ("interrupted", 4)
    assert found.cost == min(costs) < costs[0]


def test_an_interrupt_of_few_kinds_gives_the_best_so_far():
    def interrupt(progress):
        if progress.evaluations >= 3 and not interrupts.requested():
            interrupts.request()

    target = simulate(load(even("nG", 20, 4, 4)))
    scene = load(even("nG", 20, 4, 4, damping=0.4, windVel=xyz((1.0, 0.0, 2.0))))
    with interrupts.deferred():
        found = estimate(scene, target, start=3.0, fit=("auto",), observer=Watching(progress=interrupt))
    assert found.status == "interrupted"
    assert np.isfinite(found.rmse)


def test_progress_is_told_after_every_evaluation():
    told = []
    found = estimate(load(trial("Ln")), start=1.0, max_evaluations=12, observer=Watching(progress=told.append))
    assert [progress.evaluations for progress in told] == list(range(1, found.evaluations + 1))
    assert {progress.budget for progress in told} == {12}
    assert (np.diff([progress.cost for progress in told]) <= 0).all()
    assert (told[-1].cost, told[-1].rmse) == (found.cost, found.rmse)


# --- simulations that diverge


@pytest.mark.parametrize("start", [None, 1.0, 20.0])
def test_values_that_diverge_do_not_stop_a_fit(start):
    scene = unstable()
    with pytest.raises(Diverged):
        simulate(with_parameters(scene, [2 * UNSTABLE_ABOVE]))
    found = estimate(scene, start=start)
    assert found.status == "converged"
    np.testing.assert_allclose(parameters(found.scene), 30.0, rtol=1e-4)  # as above


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("settings", ["nL", "GG"])
def test_no_method_raises_where_values_diverge(method, settings):
    scene = unstable(settings)
    found = estimate(scene, start=1.0, method=method, max_evaluations=30)
    assert np.isfinite(found.cost)
    assert found.cost <= value_of(scene, 1.0)


@pytest.mark.parametrize("method", ["auto", *METHODS])
def test_a_start_that_diverges_is_never_an_exception(method):
    found = estimate(unstable(), start=1000.0, method=method, max_evaluations=30)
    assert found.status in (["converged"] if method == "auto" else ["diverged", "converged", "limit"])
    assert (found.status == "diverged") == np.isinf(found.cost)


def test_a_truth_that_diverges_is_an_exception():
    scene = load(even("nG", 60, integrationMethod=0, delta=0.004, springStiffness=[1000.0] * 33))
    with pytest.raises(Diverged, match=r"diverged at step \d+"):
        estimate(scene)


@pytest.mark.parametrize(("settings", "start"), [("Ln", UPPER), ("nL", LOWER)])
def test_a_plateau_at_a_bound_is_not_called_converged(settings, start):
    scene = load(even(settings))
    cost, _ = cost_and_gradient(with_parameters(scene, np.full(len(parameters(scene)), start)), record_target(scene))
    found = estimate(scene, start=start)
    assert found.cost < 0.01 * cost or found.status != "converged"


# --- what it refuses


ONLY_FIXED = np.tile(np.isin(np.arange(16), (0, 3)), (20, 1))
WRONG_TARGETS = {
    "initial frame only": (lambda m: Motion(m.positions[:1], m.times[:1], (16,)), "shows nothing after the start"),
    "nothing seen": (lambda m: replace(m, observed=np.zeros((20, 16), bool)), "shows nothing"),
    "only what is fixed": (lambda m: replace(m, observed=ONLY_FIXED), "shows nothing after the start that can move"),
    "other vertices": (lambda m: Motion(m.positions[:, :12], m.times, (12,)), "vertices"),
    "before the start": (lambda m: replace(m, times=m.times - 0.02), r"times\[0\]: -0.02 s is before the start"),
    "after the end": (lambda m: replace(m, times=m.times + 9.0), "shows nothing after the start"),
    "no weight": (lambda m: replace(m, weights=np.zeros((20, 16))), "shows nothing"),
    "far away": (lambda m: replace(m, times=np.append(m.times[:-1], 1e9)), "is too many steps away"),
}


@pytest.mark.parametrize("kind", WRONG_TARGETS)
def test_a_target_that_does_not_fit_is_refused(kind):
    scene = load(even("nG"))
    change, message = WRONG_TARGETS[kind]
    with pytest.raises((InvalidInput, InvalidMotion), match=message):
        estimate(scene, change(record_target(scene)))


def test_the_record_is_solved_as_tightly_as_the_fit():
    scene = load(trial("Ln"))
    tight = simulate(scene, tolerance=FIT_TOLERANCE).positions
    np.testing.assert_array_equal(record_target(scene).positions, tight)
    assert len(record_target(scene, 7).times) == 7


def interrupted(*_):
    raise KeyboardInterrupt


def test_an_interrupt_before_there_is_a_result_passes_on_and_later_one_gives_the_start(monkeypatch):
    scene = load(even("nG"))
    with monkeypatch.context() as patch:
        patch.setattr(Objective, "cost_or_infinity", interrupted)
        for method in ("l-bfgs-b", "auto"):
            with pytest.raises(KeyboardInterrupt):
                estimate(scene, method=method)
    monkeypatch.setattr(Objective, "cost_and_gradient", interrupted)
    found = estimate(scene, record_target(scene), start=20.0, method="l-bfgs-b")
    assert (found.status, found.evaluations) == ("interrupted", 0)
    assert parameters(found.scene).tolist() == [20.0]
    assert 0 < found.cost < np.inf


def test_what_the_target_does_not_show_is_listed_and_kept():
    one = even("Ln")["objects"][0]
    scene = load(document(one, changed(one, ("vertMass",), [0.05] * 16), optimizationIterations=20))
    motion = record_target(scene)
    seen = np.ones(motion.positions.shape[:2], bool)
    seen[:, 16:] = False
    half = Motion(motion.positions, motion.times, (16, 16), seen)
    found = estimate(scene, half, start=0.03)
    assert [len(block.unidentifiable) for block in found.parameters] == [2, 16]
    assert found.scene.cloths[1].mass.tolist() == [0.03] * 16
    np.testing.assert_allclose(found.scene.cloths[0].mass[4:], 0.02, rtol=1e-4)  # RMSE below 1e-8 m
