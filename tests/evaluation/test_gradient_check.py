"""The tests of a gradient on scenes: hard ones pass, faults are found, and kinks are named instead of blamed."""


import numpy as np
import pytest
from helpers.physics import METHODS, ball, scene, sheet, thing, xyz
from helpers.scenes import cloth, trial

from clothfit import Diverged, InvalidInput, load, parameters, simulate, verify, with_parameters
from clothfit.engine.forces import collider_rows
from clothfit.engine.forces.surfaces import BOX, CONE
from clothfit.engine.rollout import rollout
from clothfit.engine.system import build
from clothfit.evaluation.gradient_check import Switch, check_scene, contacts, first_switch, placed_to
from clothfit.objective.objective import Objective

pytestmark = pytest.mark.slow  # compiles a fit

ON_A_BALL = {"windVel": xyz((2, 1, 0)), "colliders": [ball((1, -0.72, 1), 0.75)], "optimizationIterations": 40}
KINDS = {"damping": "G", "dragCoefficient": "G", "vertVel": "L", "springRestLength": "G"}
ZEROS = cloth(3, 3, fit=KINDS, damping=0.0, dragCoefficient=0.0)
HARD = {
    "contact": scene(sheet("LL"), **ON_A_BALL),
    "contact, several iterations": scene(sheet("LL"), forwardSubSteps=3, **ON_A_BALL),
    "contact, explicit": scene(sheet("LL"), integrationMethod=METHODS["explicit"], delta=0.002, **ON_A_BALL),
    "contact, symplectic": scene(sheet("LL"), integrationMethod=METHODS["symplectic"], delta=0.002, **ON_A_BALL),
    "crushed": scene(cloth(3, 3, optimizationSettings="nL", springRestLength=[3.0] * 16), optimizationIterations=40),
    "passing rest length": scene(sheet("LL", springRestLength=[0.99] * 16), optimizationIterations=60),
    "stiff": scene(cloth(3, 3, optimizationSettings="LL", springStiffness=[1e7] * 16), optimizationIterations=40),
    "uneven masses": scene(cloth(3, 3, optimizationSettings="LL", vertMass=[1e-4] * 4 + [100.0] * 5)),
    "springs of no stiffness": scene(cloth(3, 3, optimizationSettings="LL", springStiffness=[0.0] * 5 + [30.0] * 11)),
    "nothing flagged": scene(cloth(3, 3)),
    "values that are 0": load({**trial("nn", 30), "fit": {"windVel": True}, "objects": [ZEROS]}),
}


def test_a_gust_on_next_to_no_mass_is_unclear_and_no_fault():
    """A step's matrix is the mass, 1e-14 kg, beside the drag's h κ |n|², 1e-3 kg: nothing is known to 1e-12."""
    places = [xyz(place) for place in ((0, 0.111, 0), (1, -0.003, 0), (0, 0.044, 1), (1, 0.07, 1))]
    light = cloth(2, 2, optimizationSettings="Ln", vertMass=[1.5e-14] * 4, vertPos=places, vertIsFixed=[False] * 4)
    still = {**light, "springStiffness": [0.0] * len(light["springStiffness"]), "dragCoefficient": 10, "damping": 0.1}
    blown = scene(still, delta=1e-3, tolerance=1e-15, windVel=xyz((838.6, 586.1, 183.8)), optimizationIterations=3)
    assert {test.verdict for test in check_scene(blown).tests} == {"unclear"}


def test_what_is_below_the_tolerance_of_the_linear_systems_is_no_fault():
    """Pushed out of a ball by 1000 N/m, with springs of 0.05 N/m: they change less than the solutions are known to."""
    rng = np.random.default_rng(0)
    uneven = [xyz((i, 0.05 * rng.normal(), j)) for j in range(4) for i in range(3)]
    still = {"vertPos": uneven, "vertIsFixed": [4 <= i < 6 for i in range(12)], "damping": 0.0, "dragCoefficient": 0.0}
    soft = cloth(3, 4, optimizationSettings="nG", springStiffness=[0.05] * 23, **still)
    pushed = {"colliders": [ball((0.217, 0.115, -0.233), 0.25)], "integrationMethod": METHODS["bdf2"]}
    found = check_scene(scene(soft, delta=1e-3, optimizationIterations=3, **pushed))
    assert [test.verdict for test in found.tests] == ["unclear", "unclear", "passed"]


RIGHT = Objective.add_pullback


def faulty(objective, run, p, system, memory, by_position, gradient):
    """Half of the gradient is wrong by one part in ten thousand."""
    RIGHT(objective, run, p, system, memory, by_position, gradient)
    gradient[: len(gradient) // 2] *= 1.0001


@pytest.mark.parametrize("name", list(HARD))
def test_the_gradient_is_right_in_hard_places_and_a_fault_is_found_there(name, monkeypatch):
    found = check_scene(HARD[name])
    assert (found.verdict, found.tests[0].verdict) == ("passed", "passed")
    assert found.flagged == (name != "nothing flagged")
    if name != "values that are 0":
        monkeypatch.setattr(Objective, "add_pullback", faulty)
        found = check_scene(HARD[name])
        assert (found.verdict, found.tests[2].verdict) == ("failed", "failed")
        assert "failed" in [test.verdict for test in found.tests[:2]]


# --- contacts that switch


def dropped(mass):
    """A vertex on a spring that swings down onto a sphere; its mass says when it enters."""
    pair = thing(
        [(0, 0, 0), (1, 0, 0)], [(0, 1)], mass=[0.1, mass], stiffness=8.0, fixed=(0,), optimizationSettings="Ln"
    )
    return scene(pair, colliders=[ball((0.4, -1.3, 0), 0.5)], optimizationIterations=60)


def touched(mass):
    system = build(dropped(mass), 0)
    return contacts(system, rollout(system, 59, 1e-14)[0])


def edge():
    """A mass next to which, to rounding, a contact switches."""
    low, high = 0.1, 0.2
    first = touched(low)
    assert first_switch(first, touched(high)) is not None
    for _ in range(48):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if np.array_equal(first, touched(middle)) else (low, middle)
    return low


@pytest.mark.parametrize("distance", [1e-3, 1e-5])
def test_near_a_contact_that_switches_shorter_steps_are_judged(distance):
    made = dropped(edge() * (1 - distance))
    found = check_scene(made)
    assert found.verdict == "passed"
    assert 0 < found.reach < 10 * distance  # of its own value the mass changes by less than the step
    assert found.left_out.startswith(f"steps above {found.reach:.1g} of the values are left out: contacts switch (")
    truth = simulate(with_parameters(made, 1.1 * parameters(made)))
    assert not verify.check(Objective(made, truth), parameters(made)).passed  # as it takes all of them


def test_at_a_contact_that_switches_there_is_a_kink_and_nothing_is_blamed():
    found = check_scene(dropped(edge() * (1 - 1e-9)))
    assert (found.verdict, found.reach) == ("unclear", 0.0)
    kink = "the cost has a kink here, within 1e-07 of the values: contacts switch (objects[0] vertex 1 at sphere 0, "
    assert found.why.startswith(kink)
    assert found.tests[2].verdict == "passed"  # the sweeps do not mind


def test_contacts_are_those_where_forces_are_taken():
    system = build(HARD["contact, several iterations"], 0)
    part, _ = rollout(system, 20, 1e-12)
    found, centre, radius = contacts(system, part), system.spheres.centre[0], system.spheres.radius[0]
    assert found.shape == (20, 3, 1, 9)
    for t in (0, 7, 19):
        for k in range(part.used[t]):
            y = part.x[t] + (system.h * part.w[t, k - 1] if k else 0.0)
            np.testing.assert_array_equal(found[t, k, 0], np.linalg.norm(y - centre, axis=1) < radius)
        assert not found[t, part.used[t] :].any()


@pytest.mark.parametrize("method", ["implicit", "bdf2", "symplectic"])
def test_contacts_with_what_moves_are_those_where_forces_are_taken(method):
    """A vertex has left its straight way exactly where it has touched something before."""
    path = {"posKeys": {"times": [0, 1], "values": [xyz((0, 0, 0)), xyz((-1.2, 0, 0))]}}
    for obstacle in (ball((1, 0, 0), 0.3), {"type": 3, "pos": xyz((1, 0, 0)), "scale": xyz([0.6] * 3)}):
        made = scene(
            thing([(0, 0, 0)]), colliders=[{**obstacle, **path}], gravity=xyz((0, 0, 0)), delta=0.01, tolerance=1e-12,
            integrationMethod=METHODS[method], optimizationIterations=101,
        )  # fmt: skip
        system = build(made, 0)
        part, good = rollout(system, 100, 1e-12)
        assert good == 100
        found = contacts(system, part)[:, 0, 0, 0]
        first = int(np.argmax(found > 0))
        assert 50 < first < 65  # 0.7 m away at 1.2 m/s
        moved = np.any(part.x[1:, 0] != 0, axis=1)
        assert int(np.argmax(moved)) == first


@pytest.mark.parametrize(("kind", "size"), [(BOX, (0.5, 0.3, 0.4)), (CONE, (0.5, 0.2, 0.9)), (CONE, (0.3, 0.3, 0.8))])
def test_a_normal_bends_smoothly_within_a_part_of_a_surface_and_nowhere_else(kind, size):
    state = np.concatenate([np.zeros((3, 3)), np.eye(3), [size], np.zeros((1, 3))])[None]
    one, rng = collider_rows.build([kind], [(2.0, 1.0, 0.0)], state), np.random.default_rng(5)
    share, kinks = np.linspace(0, 1, 4001)[:, None], 0
    for begin, end in rng.uniform(-1.2, 1.2, (30, 2, 3)):
        y = (1 - share) * begin + share * end
        part, (depth, normal) = np.empty((1, len(y)), np.int32), collider_rows.depths(one, y)
        collider_rows.fill_parts(one, y, part)
        part = part[0]
        bend = np.linalg.norm(np.diff(normal[0], 2, axis=0), axis=1)
        same = (part[2:] == part[1:-1]) & (part[:-2] == part[1:-1])
        # a normal turns by less than the step, up to 1 mm, over the distance to what it turns about
        about = np.abs(2.0 - depth[0, 1:-1] + (min(size[:2]) if kind == CONE else 0.0))
        far = about > 0.1
        assert np.all(bend[same & far] < 4e-6 / about[same & far] ** 2)
        kinks += int((bend[~same & far] > 1e-5).sum())
    assert kinks > 20  # and does jump, or begins to turn, between them


def test_the_first_switch_is_the_earliest():
    a, b, inside = np.zeros((5, 2, 3, 4), int), np.zeros((5, 2, 3, 4), int), np.ones((5, 2, 3, 4), int)
    b[3, 0, 1, 2] = b[4, 0, 0, 0] = 1
    assert first_switch(a, b) == Switch(4, 2, 1)
    assert first_switch(a, a.copy()) is None
    assert Switch(4, 2, 1).at("sphere 1") == "vertex 2 at sphere 1, step 4"
    found = first_switch(inside, inside + 6 * (np.arange(120).reshape(inside.shape) == 55))
    assert found == Switch(3, 3, 1, True)
    assert found.at("sphere 1") == "vertex 3 at two parts of sphere 1, step 3"


def test_the_collider_that_is_switched_is_named():
    """It slides down from a box: how soon depends on gravity."""
    box, away = ({"type": 3, "pos": xyz((x, 0, 0)), "scale": xyz([1] * 3)} for x in (0, 9))
    made = scene(
        thing([(0.2, 0.499, 0)], mass=0.1), colliders=[{**box, "type": 0}, away, box], gravity=xyz((3, -9.81, 0)),
        fit={"gravity": True}, optimizationIterations=30,
    )  # fmt: skip
    found = check_scene(made)
    assert "contacts switch (objects[0] vertex 0 at the box colliders[2], step " in found.left_out


# --- targets and lengths


def test_a_target_is_compared_with():
    made = HARD["contact"]
    target = simulate(with_parameters(made, 1.3 * parameters(made)), 20)
    found = check_scene(made, target, 15)
    assert (found.verdict, found.frames) == ("passed", 15)
    own = check_scene(made, None, 15)
    assert found.tests != own.tests
    assert check_scene(made, None, 15) == own
    assert check_scene(made, None, 15, seed=1).tests != own.tests  # the direction is drawn


def test_what_changes_nothing_is_unclear_and_what_shows_nothing_cannot_be_checked_with():
    """Masses in free fall, and a cloth that is held everywhere."""
    falling = scene(thing([(0, 5, 0), (1, 5, 0)], optimizationSettings="Ln"), optimizationIterations=10)
    held = scene(cloth(3, 3, optimizationSettings="LL", vertIsFixed=[True] * 9), optimizationIterations=10)
    assert [check_scene(made).verdict for made in (falling, held)] == ["unclear", "unclear"]
    with pytest.raises(InvalidInput, match=r"shows nothing after the start that can move, within 1 frames"):
        check_scene(HARD["contact"], simulate(HARD["contact"], 1), 1)
    with pytest.raises(Diverged):
        check_scene(scene(sheet("LL", springStiffness=[1e6] * 16), integrationMethod=0, delta=0.05))


@pytest.mark.parametrize(
    ("mass", "stiffness", "damping"), [(1e-100, 30.0, 0.1), (1e-5, 30.0, 1e12), (0.02, 1e101, 0.1)]
)
def test_where_numbers_do_not_resolve_the_systems_nothing_is_called_wrong(mass, stiffness, damping):
    """A vertex or spring that is 1e15 times and more lighter or stiffer than others: solutions are rounding there."""
    made = trial("nL", 3, 3, 3)
    own = made["objects"][0]
    own["vertMass"][4], own["springStiffness"][7], own["damping"] = mass, stiffness, damping
    with np.errstate(all="ignore"):
        assert check_scene(load(made)).verdict in ("unclear", "passed")


@pytest.mark.parametrize(("size", "verdict"), [(1e-160, "unclear"), (1e-120, "passed")])
def test_where_squares_of_lengths_vanish_nothing_is_called_wrong(size, verdict):
    """Solvers sum squares of lengths: those of 1e-160 m are 0 in doubles, those of 1e-120 m are not."""
    made = trial("nL", 3, 3, 3)
    own = made["objects"][0]
    own["vertPos"] = [{axis: size * value for axis, value in at.items()} for at in own["vertPos"]]
    made["gravity"], made["windVel"] = xyz((0, -9.81 * size, 0)), xyz((0, 0, 0))
    with np.errstate(all="ignore"):
        assert check_scene(load(made), frames=3).tests[2].verdict == verdict


def test_the_rounding_of_positions_counts_relative_to_what_the_motions_differ_by():
    made = scene(sheet("LL"))
    truth = simulate(with_parameters(made, 1.1 * parameters(made)))
    objective = Objective(made, truth)
    largest = np.abs(made.cloths[0].positions).max()
    # residuals of 1e-3 m: their squares, over 1 m², change by 2 ε · 1 m / 1e-3 m where each moves by ε · 1 m
    cost = 1e-6 * objective.cost(parameters(made)) / objective.rmse(objective.cost(parameters(made))) ** 2
    assert placed_to(objective, cost) == pytest.approx(np.finfo(float).eps * largest / 1e-3, rel=1e-12)
    assert placed_to(objective, 0.0) == 0.0
