"""Models from coarse to fine: their flags, that each contains those before it, and that no error rises."""

from itertools import pairwise

import numpy as np
import pytest
from helpers.strangers import small, with_finer_steps

from clothfit.fit import few_values, hierarchy
from clothfit.motion.degrade import degrade
from clothfit.motion.motion import at_frames
from clothfit.motion.simulate import simulate
from clothfit.objective.objective import Objective
from clothfit.optimise.search import Search
from clothfit.optimise.status import Status, Stop
from clothfit.scene.fit_vector import parameters, with_parameters

FLAGS = {  # letters of masses and stiffnesses, and what else a cloth fits
    "stiffnesses": ("nL", {}),
    "factors": ("FF", {}),
    "families": ("RL", {}),
    "one value": ("GL", {}),
    "with damping": ("nL", {"damping": "G"}),
    "lengths": ("nn", {"springRestLength": "L"}),
    "velocities": ("nL", {"vertVel": "L"}),
    "one velocity": ("nL", {"vertVel": "G"}),
    "only damping": ("nn", {"damping": "G"}),
}

AS_MODEL = {  # of the flags above: the letters of coarser models
    ("stiffnesses", "F"): {"stiffness": "F"},
    ("stiffnesses", "G"): {"stiffness": "G"},
    ("factors", "R"): {"mass": "F", "stiffness": "F"},
    ("families", "F"): {"mass": "F", "stiffness": "F"},
    ("families", "R"): {"mass": "R", "stiffness": "R"},
    ("families", "M"): {"mass": "R", "stiffness": "M"},
    ("one value", "F"): {"mass": "G", "stiffness": "F"},
    ("with damping", "F"): {"stiffness": "F", "damping": "G"},
    ("lengths", "M"): {"rest": "M"},
    ("velocities", "M"): {"stiffness": "M"},
    ("velocities", "L"): {"stiffness": "L", "velocity": "L"},
    ("one velocity", "F"): {"stiffness": "F", "velocity": "G"},
    ("only damping", "F"): {"damping": "G"},
}

EXACTLY = {  # the same where a model takes the place of all flags
    ("stiffnesses", "R"): {"stiffness": "R"},
    ("factors", "L"): {"mass": "L", "stiffness": "L"},
    ("families", "G"): {"mass": "G", "stiffness": "G"},
    ("one value", "F"): {"mass": "F", "stiffness": "F"},
    ("with damping", "L"): {"stiffness": "L", "damping": "G"},
    ("lengths", "F"): {"rest": "F"},
    ("velocities", "L"): {"stiffness": "L", "velocity": "L"},
    ("one velocity", "L"): {"stiffness": "L", "velocity": "G"},
    ("only damping", "L"): {"damping": "G"},
}


def flagged(kind, **fields):
    """A small scene with those flags."""
    letters, fit = FLAGS[kind]
    return small(letters, of_cloth=fit, **fields)


@pytest.mark.parametrize("exactly", [False, True])
def test_a_model_takes_the_place_of_finer_flags_or_of_all_masses_stiffnesses_and_lengths(exactly):
    for (kind, model), expected in (EXACTLY if exactly else AS_MODEL).items():
        found = hierarchy.as_model(flagged(kind), model, exactly=exactly)
        assert hierarchy.letters(found.cloths[0]) == expected, (kind, model)


def test_the_model_of_a_scene_is_its_finest():
    found = {kind: hierarchy.model_of(flagged(kind)) for kind in FLAGS}
    assert {kind for kind, model in found.items() if model != "L"} == {"factors", "only damping"}
    assert (found["factors"], found["only damping"]) == ("F", "G")


@pytest.mark.parametrize("kind", FLAGS)
def test_models_end_with_the_own_one_and_have_more_and_more_values(kind):
    scene = flagged(kind)
    same = hierarchy.as_model(scene, hierarchy.model_of(scene))
    assert hierarchy.letters(same.cloths[0]) == hierarchy.letters(scene.cloths[0])
    found = hierarchy.models(scene)
    counts = [hierarchy.count(hierarchy.as_model(scene, model)) for model in found]
    assert found[-1] == hierarchy.model_of(scene)
    assert all(few < many for few, many in pairwise(counts))
    assert hierarchy.count(scene) == counts[-1] == len(parameters(scene))


def test_of_models_with_as_many_values_the_coarsest_stays():
    # the springs of one family, so that R is F; two of them, so that M is L
    strip = small("nL", triangles=[], springs=[0, 4, 5, 9], springStiffness=[20.0, 30.0])
    assert hierarchy.models(strip) == ["F", "L"]
    assert hierarchy.models(small("nR", triangles=[], springs=[0, 4, 5, 9], springStiffness=[20.0, 30.0])) == ["R"]


# --- values


def search_of(letters="LL", frames=16, count=4, rmse=0.0, **fields):
    """A search of a target by finer steps, which no values reproduce, from the truth."""
    scene = small(letters, frames, **fields)
    return Search(Objective(scene, with_finer_steps(scene, count), 1e-10), parameters(scene), rmse, 10**6)


def spread(p, seed, size=0.3):
    """Values that scatter around p (P,)."""
    return p * np.exp(size * np.random.default_rng(seed).normal(size=len(p)))


@pytest.mark.parametrize(("coarse", "fine"), [*pairwise("FRML")], ids=str)
def test_each_model_contains_those_before_it(coarse, fine):
    scene = small("LL", vertMass=[0.002 + 1e-4 * i for i in range(16)])
    less, more = hierarchy.as_model(scene, coarse), hierarchy.as_model(scene, fine)
    wanted = with_parameters(less, spread(parameters(less), 1))
    found = with_parameters(more, parameters(wanted, flags=more))  # on the same values of the scene
    for name in ("mass", "stiffness"):  # rounding of sums of maps
        np.testing.assert_allclose(getattr(found.cloths[0], name), getattr(wanted.cloths[0], name), rtol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("model", "FRML")
def test_a_stage_begins_with_the_cost_of_the_best_before(model):
    search = search_of()
    p = spread(search.start, 2)
    part = hierarchy.subproblem(search, model, p)
    assert part.objective.cost(part.start) == pytest.approx(search.objective.cost(p), rel=1e-5)  # systems to 1e-7
    part.best.offer(part.start, 0.0)
    np.testing.assert_allclose(hierarchy.as_flagged(part, search.objective.scene), p, rtol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("method", [2, 3])
def test_no_model_ends_above_a_smaller_one(method):
    search = search_of("nL", 24, count=8, method=method)
    wanted = hierarchy.models(search.objective.scene)
    first = search.objective.rmse(search.objective.cost(search.start))
    hierarchy.refine(search, wanted, [search.start])
    errors = [each.rmse for each in search.levels]
    assert [each.model for each in search.levels] == wanted
    assert all(after <= before for before, after in pairwise([first, *errors]))
    assert errors[-1] < errors[0] < first  # single values follow what one factor cannot
    for each in search.levels:  # the values of each are those of its error
        assert search.objective.rmse(search.objective.cost(each.p)) == pytest.approx(each.rmse, rel=1e-9)
    assert search.best.p.tolist() == search.levels[-1].p.tolist()


@pytest.mark.slow
def test_one_factor_is_found_from_far_away():
    truth = small("nF", 24)
    start = with_parameters(truth, np.array([0.4]))
    target = degrade(simulate(truth, tolerance=1e-12), noise=1e-4, seed=2)
    search = Search(Objective(start, target, 1e-10), parameters(start), 0.0, 10**6)
    hierarchy.refine(search, ["F"], [search.start])
    # 360 positions with noise of 0.1 mm, of a motion of decimetres that follows the stiffness
    assert search.best.p == pytest.approx([2.5 * parameters(start)[0]], rel=0.01)


@pytest.mark.slow
def test_a_fit_that_is_late_ends_with_its_first_model_and_says_so():
    search = search_of("nL")
    search.longest = 0.0
    hierarchy.refine(search, "FRML", [search.start])
    assert [each.model for each in search.levels] == ["F"]
    hierarchy.warn_where_late(search, Status.CONVERGED)  # more time would find nothing
    assert not search.warnings
    hierarchy.warn_where_late(search, Status.STALLED)
    assert [text for text in search.warnings if "--budget gives it more" in text]


# --- how a stage ends


def carried(search, end=None):
    """A stage by one factor that visits a better point, of which it says that it costs nothing, and then ends."""

    def method(part):
        assert part.best.offer(1.01 * part.start, 0.0)
        if end is not None:
            raise end

    hierarchy.run_subproblem(search, hierarchy.subproblem(search, "F", search.start), method)


@pytest.mark.slow
@pytest.mark.parametrize("end", [KeyboardInterrupt(), MemoryError()], ids=repr)
def test_the_best_point_of_a_stage_is_kept_whatever_ends_it(end):
    search = search_of("nL")
    with pytest.raises(type(end)):
        carried(search, end)
    assert search.best.cost == search.objective.cost(search.best.p)
    np.testing.assert_allclose(search.best.p, 1.01 * search.start, rtol=1e-12)


@pytest.mark.slow
def test_only_the_end_of_the_budget_ends_the_stages_after_it():
    search = search_of("nL")
    for status in (Status.CONVERGED, Status.STALLED):
        carried(search, Stop(status))
    with pytest.raises(Stop) as caught:
        carried(search, Stop(Status.LIMIT))
    assert caught.value.status == Status.LIMIT


@pytest.mark.slow
def test_a_stage_is_judged_by_the_cost_of_the_whole():
    search = search_of("nL")
    search.visit(search.start)
    before = search.best.cost
    carried(search)
    assert search.best.cost == min(before, search.objective.cost(1.01 * search.start))


@pytest.mark.parametrize("every", [1, 3])
def test_steps_from_frame_to_frame(every):
    scene = small("nL", 13)
    target = at_frames(simulate(scene), slice(None, None, every))
    assert few_values.frame_steps(Objective(scene, target, 1e-10)) == every
