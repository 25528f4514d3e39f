"""The momentum fit: balances along a motion, parameters straight from them, and what noise, gaps, odd steps leave."""

import numpy as np
import pytest
from helpers.physics import METHODS, TIGHT, ball, scene, xyz
from helpers.scenes import cloth
from numpy.testing import assert_allclose
from scipy.sparse import csr_array

from clothfit.engine.prescribed import forms_of
from clothfit.engine.rollout import rollout
from clothfit.engine.system import all_elements, build, with_elements
from clothfit.meshes.mesh import object_document, plane, springs
from clothfit.motion.degrade import degrade
from clothfit.motion.motion import Motion
from clothfit.motion.simulate import simulate
from clothfit.objective.objective import Objective
from clothfit.optimise import along_target, momentum, trust_region
from clothfit.optimise.along_target import AlongTarget, SingleSteps
from clothfit.optimise.balances import Equations, Patch, Rows, Track, balances, relative, smoothed, summed_twice, track
from clothfit.optimise.consensus import agreeing, balanced_beside, in_balance, trimmed
from clothfit.optimise.momentum import ANCHORED, TREATMENTS, Treatment
from clothfit.scene.fit_vector import parameters, with_parameters

pytestmark = pytest.mark.slow  # compiles a fit

VARIANTS = [("explicit", 1), ("symplectic", 1), ("implicit", 1), ("implicit", 12), ("bdf2", 1), ("bdf2", 12)]
AIR = {"windVel": xyz((4, 2, -3))}
SPHERE = {"colliders": [ball((1.0, -0.748, 1.0), 0.75)]}
FRAMES = 25


def sheet(settings="LL", nx=4, ny=4, alike=False, **fields):
    """A heavy cloth in motion, in the air; with one mass and one stiffness all over where all are `alike`."""
    n, springs = nx * ny, len(cloth(nx, ny)["springStiffness"])
    rng = np.random.default_rng(31)
    mass = [0.06] * n if alike else rng.uniform(0.04, 0.08, n).tolist()
    stiffness = [30.0] * springs if alike else rng.uniform(15.0, 60.0, springs).tolist()
    made = {"vertMass": mass, "springStiffness": stiffness, "dragCoefficient": 0.3, "damping": 0.2, **fields}
    return cloth(nx, ny, optimizationSettings=settings, **made)


def made(*objects, method="implicit", newton=1, frames=FRAMES, **fields):
    delta = 0.02 if method in ("implicit", "bdf2") else 0.005
    chosen = {"integrationMethod": METHODS[method], "forwardSubSteps": newton, "delta": delta}
    return scene(*objects, **{**chosen, "optimizationIterations": frames, "tolerance": 1e-13, **AIR, **fields})


def fitted(given, motion=None, treatment=TREATMENTS[0], start=None):
    """The fit of a scene's own motion from another start, and what was fitted (P,)."""
    aim = Objective(given, simulate(given, tolerance=TIGHT) if motion is None else motion, TIGHT)
    p = parameters(given)
    away = np.exp(0.5 * np.random.default_rng(1).normal(size=len(p))) * p if start is None else start
    return momentum.Momentum(aim, away, aim.identifiable).fit(treatment), aim.identifiable, away


def assert_found(given, motion=None):
    """That the values come out of a motion, the scene's own or another, and what cannot stays where it was."""
    p, kept, away = fitted(given, motion)
    # velocities are differences of metres over h, and accelerations over h²: 1e-16 / 4e-4 against 1 … 10, and worse
    # for springs that hardly stretch
    np.testing.assert_allclose(p[kept], parameters(given)[kept], rtol=1e-6)
    np.testing.assert_array_equal(p[~kept], away[~kept])


# --- exact targets


@pytest.mark.parametrize(("method", "newton"), VARIANTS)
@pytest.mark.parametrize("settings", ["nL", "Ln", "LL", "nG", "Gn", "GG", "GL", "LG"])
def test_every_element_comes_out_of_an_exact_motion_and_one_value_where_all_are_alike(settings, method, newton):
    assert_found(made(sheet(settings, alike="G" in settings), method=method, newton=newton))


def test_a_common_factor_that_only_thin_air_shows_comes_out_of_sparse_equations(monkeypatch):
    monkeypatch.setattr(trust_region, "SPARSE", 0)
    given = made(sheet(nx=10, ny=10, dragCoefficient=1e-6))
    p, kept, _ = fitted(given)
    # air is 1e-7 of the forces, as large as the square root of what is added to keep CᵀC regular; it is known to 1e-13
    np.testing.assert_allclose(p[kept], parameters(given)[kept], rtol=2e-8)


@pytest.mark.parametrize("method", METHODS)
def test_on_a_sphere(method):
    assert_found(made(sheet(nx=3, ny=3), method=method, **SPHERE))


def test_several_cloths_each_by_its_own_rows():
    given = made(sheet("LL", 3, 3), sheet("nn", 3, 4), sheet("nG", 3, 3, alike=True), sheet("Ln", 2, 3))
    assert_found(given)


def test_several_experiments_add_their_rows():
    # too few frames in each: 14 free vertices give 84 equations for 47 unknowns, badly; all three of them do better
    given = made(sheet(), frames=4)
    scenes = [made(sheet(), frames=12, windVel=xyz(wind)) for wind in ((4, 2, -3), (-8, 5, 1), (0, -9, 6))]
    motions = [(simulate(one, tolerance=TIGHT), one) for one in scenes]
    assert_found(given, motions)


def test_without_air_masses_and_stiffnesses_keep_their_common_factor():
    given = made(sheet(nx=3, ny=3, dragCoefficient=0.0))
    p, kept, away = fitted(given)
    # Balances without a right-hand side: the answer nearest to the start is 0 but for what the start keeps of it.
    ratio = p[kept] / parameters(given)[kept]
    np.testing.assert_allclose(ratio, ratio[0], rtol=1e-5)
    assert np.linalg.norm(away[kept]) > np.linalg.norm(p[kept] - away[kept]) > 0
    assert ratio[0] > 0


@pytest.mark.parametrize(("delta", "shortened"), [(0.03, 0), (0.04, 1)])
def test_steps_that_the_guard_made_otherwise_are_left_out(delta, shortened):
    given = whipping(delta)
    memory, _ = rollout(build(given, 0), 59, TIGHT)
    assert (memory.euler.sum() > 1, (memory.theta < 1).sum()) == (True, shortened)  # it whips through
    assert_found(given)


def test_steps_that_were_taken_otherwise_are_out_of_balance():
    high = 0.02 * np.random.default_rng(8).normal(size=32)[16:]
    lying = [xyz((i % 4, float(high[i]), i // 4)) for i in range(16)]
    stiffness = np.linspace(1000.0, 2000.0, 33).tolist()
    free = {"damping": 0.0, "dragCoefficient": 0.0, "vertIsFixed": [i < 4 for i in range(16)]}
    one = sheet("nL", vertPos=lying, vertMass=[0.02] * 16, springStiffness=stiffness, **free)
    given = made(one, delta=0.1, frames=40)
    memory, _ = rollout(build(given, 0), 39, TIGHT)
    assert memory.clamped.any()
    assert (memory.theta < 1).any()
    aim, p = Objective(given, simulate(given, tolerance=TIGHT), TIGHT), parameters(given)
    column = np.where(aim.identifiable, np.cumsum(aim.identifiable) - 1, -1).astype(np.int32)
    rows = Equations([momentum.rows_of(aim.runs[0], p, list(aim.blocks), column, TREATMENTS[0])])
    good = in_balance(rows, rows.counts > 0, np.zeros(int(aim.identifiable.sum())))
    np.testing.assert_array_equal(good, ~(memory.clamped | (memory.theta < 1)))
    assert_found(given)


def test_the_ratio_comes_out_of_rounded_positions_where_the_whole_mass_is_held():
    given = made(sheet("GG", alike=True, dragCoefficient=1e-5), frames=40)
    exact = simulate(given, tolerance=TIGHT)
    rounded = Motion(exact.positions.astype(np.float32).astype(float), exact.times, exact.vertex_counts)
    alone, _, away = fitted(given, rounded)
    p, _, _ = fitted(given, rounded, ANCHORED)
    truth = parameters(given)
    assert p[0] == pytest.approx(away[0], rel=1e-5)  # the weight of the anchor
    # 2⁻²⁴ of 1 m over h² is 1e-4 of accelerations of 10; the air, which shows the mass, is 1e-5 of them
    assert p[1] / p[0] == pytest.approx(truth[1] / truth[0], rel=1e-3)
    assert abs(np.log(alone[0] / truth[0])) > 1.0  # and drowns


def test_there_is_a_mass_to_hold_where_masses_and_stiffnesses_of_a_cloth_are_fitted():
    for settings, expected in {("GG",): True, ("LL",): True, ("nL",): False, ("Gn", "nG"): False}.items():
        given = made(*(sheet(each, 3, 3) for each in settings), frames=4)
        aim = Objective(given, simulate(given), TIGHT)
        assert momentum.anchors(aim, aim.identifiable) is expected


def whipping(delta=0.04):
    """A sheet that is held at one side and whips through: steps are shortened, and by implicit Euler."""
    stiffness = np.random.default_rng(3).uniform(500, 1500, 56).tolist()
    hung = {"vertIsFixed": [i < 5 for i in range(25)], "springStiffness": stiffness, "damping": 0.02}
    return made(sheet("nL", 5, 5, dragCoefficient=0.0, **hung), method="bdf2", frames=60, delta=delta)


def test_each_single_step_of_a_motion_is_taken_to_where_it_ends_however_it_was_taken():
    given = whipping()
    memory, _ = rollout(build(given, 0), 59, TIGHT)
    assert (memory.theta < 1).any()
    assert memory.euler.sum() > 1
    target, p = simulate(given, tolerance=TIGHT), parameters(given)
    aim = Objective(given, target, TIGHT)
    assert AlongTarget.of(aim, p).steps == SingleSteps(59, 0.0, 0.0)  # the same computation
    assert AlongTarget.of(aim, 1.01 * p).steps.rmse > 1e-5  # a hundredth of steps of millimetres to decimetres
    rounded = Objective(given, Motion(np.round(target.positions, 7), target.times, target.vertex_counts), TIGHT)
    # the weights of four positions, and its own end: 55/9 + 1 roundings at most
    assert 0.1 * rounded.rounding < AlongTarget.of(rounded, p).steps.largest < 7.2 * rounded.rounding


def rounded_whipping():
    given = whipping()
    target = simulate(given, tolerance=TIGHT)
    rounded = Motion(np.round(target.positions, 7), target.times, target.vertex_counts)
    return given, target, Objective(given, rounded, TIGHT)


@pytest.mark.parametrize("whole", [False, True])
def test_what_values_make_of_steps_along_a_target_is_their_derivative(whole, monkeypatch):
    monkeypatch.setattr(along_target, "LOOSE", TIGHT)
    _, _, aim = rounded_whipping()
    p, rng = parameters(aim.scene), np.random.default_rng(2)
    z, along = p * rng.normal(size=len(p)), AlongTarget.of(aim, p, whole)
    (change,), w = along.forward(z), rng.normal(size=along.residuals()[0].shape)
    w[0] = 0.0  # of the start nothing changes
    # sweeps solved to 1e-14 of sums of 4,500 products
    assert (change * w).sum() == pytest.approx(z @ along.back([w * (change != 0.0)]), rel=1e-9)
    before, after = (AlongTarget.of(aim, p + share * z, whole).residuals()[0] for share in (-1e-7, 1e-7))
    # differences of second order, and what the change of J makes of the rounding: both 1e-7 of the motion's decimetres
    assert np.abs((after - before) / 2e-7 - change).max() < 1e-4 * np.abs(change).max()


def test_values_from_steps_along_a_rounded_target_bring_steps_and_then_the_motion_nearer():
    given, target, aim = rounded_whipping()
    p = parameters(given)
    balances = momentum.Momentum(aim, np.full(len(p), 700.0), aim.identifiable)
    found = [balances.fit()]
    for whole in (False, True):
        found.append(balances.along_targets(found[-1], whole, lambda: None))
    steps = [AlongTarget.of(aim, each).steps for each in found]
    assert steps[1].rmse < steps[0].rmse  # of which it makes the squares least
    assert steps[1].largest < 7.2 * aim.rounding  # as that of the values themselves
    errors = [np.sqrt(((simulate_of(given, each) - target.positions) ** 2).sum(axis=2).mean()) for each in found]
    # least squares leave the share of the values among the 4,500 coordinates of the rounding, and the first order
    assert errors[2] < min(aim.rounding, errors[0])


def simulate_of(given, p):
    return simulate(with_parameters(given, p), tolerance=TIGHT).positions


def test_single_steps_pass_over_what_is_not_seen_and_explicit_ones_show_nothing():
    given = made(sheet("nL"), method="bdf2")
    motion, p = simulate(given, tolerance=TIGHT), parameters(given)
    where = np.random.default_rng(9).uniform(size=motion.positions.shape[:2]) < 0.05
    found = AlongTarget.of(Objective(given, hide(motion, where), TIGHT), p).steps
    assert found.largest < 1e-12  # rounding of positions over h, as motions and target part where nothing is seen
    explicit = made(sheet("nL"), method="explicit")
    assert AlongTarget.of(Objective(explicit, simulate(explicit), TIGHT), parameters(explicit)) is None


# --- targets with gaps


def hide(motion, where):
    """The motion without the vertices of `where` (frames, vertices)."""
    return Motion(np.where(where[:, :, None], np.nan, motion.positions), motion.times, motion.vertex_counts, ~where)


def test_gaps_are_passed_over_while_enough_is_left():
    given = made(sheet("nL"), frames=120)
    motion = simulate(given, tolerance=TIGHT)
    where = np.random.default_rng(9).uniform(size=motion.positions.shape[:2]) < 0.05
    assert_found(given, hide(motion, where))


def test_what_is_never_seen_keeps_its_start():
    given = made(sheet("LL"))
    motion = simulate(given, tolerance=TIGHT)
    where = np.zeros(motion.positions.shape[:2], bool)
    where[:, 15] = True  # a corner; its neighbours' balances need it
    p, _, away = fitted(given, hide(motion, where))
    springs = given.cloths[0].springs
    beside = set(springs[(springs == 15).any(axis=1)].ravel().tolist())
    told = [i for i in range(2, 16) if i not in beside and i != 3]
    np.testing.assert_allclose(p[told], parameters(given)[told], rtol=1e-5)  # fewer rows than above
    assert p[15] == away[15]
    lost = [16 + s for s, ends in enumerate(springs.tolist()) if 15 in ends]
    np.testing.assert_array_equal(p[lost], away[lost])


@pytest.mark.parametrize("seen", ["every second", "every third", "between the steps"])
def test_without_successive_frames_at_the_steps_everything_stays(seen):
    given = made(sheet())
    motion = simulate(given, tolerance=TIGHT)
    between = Motion(0.5 * (motion.positions[1:] + motion.positions[:-1]), motion.times[:-1] + 0.01, (16,))
    every = {"every second": 2, "every third": 3}
    p, _, away = fitted(given, degrade(motion, every=every[seen]) if seen in every else between)
    np.testing.assert_array_equal(p, away)


def test_what_is_not_to_be_fitted_stays():
    given = made(sheet())
    aim, p = Objective(given, simulate(given, tolerance=TIGHT), TIGHT), parameters(given)
    some = aim.identifiable.copy()
    some[::2] = False
    away = np.where(some, 1.5 * p, p)
    found = momentum.Momentum(aim, away, some).fit()
    np.testing.assert_array_equal(found[~some], p[~some])
    np.testing.assert_allclose(found[some], p[some], rtol=1e-6)  # as above


def test_the_bounds_are_kept():
    given = made(sheet("nL", springStiffness=[2e4] * 3 + [30.0] * 30, fit={"bounds": {"stiffness": [1, 1e4]}}))
    p, kept, _ = fitted(given, start=np.full(33, 25.0))
    assert (p[:3][kept[:3]] == 1e4).all()
    assert ((p >= 1e-4) & (p <= 1e4)).all()


# --- noise


def error(given, exact, noise, treatment):
    """Median deviation of the logarithms from the truth, of three noises the one in the middle."""
    gaps = []
    for seed in range(3):
        p, kept, _ = fitted(given, degrade(exact, noise, seed=seed), treatment)
        gaps.append(np.median(np.abs(np.log(p[kept] / parameters(given)[kept]))))
    return np.median(gaps)


@pytest.mark.parametrize("settings", ["nL", "LL"])
def test_sums_of_sums_take_noise_for_what_it_is(settings):
    given = made(sheet(settings), frames=100)
    exact = simulate(given, tolerance=TIGHT)
    alone, summed = (error(given, exact, 1e-4, Treatment(1, chosen)) for chosen in (False, True))
    # Rows alone see σ/h² (1e-4 over 4e-4 of accelerations of 10), squared by its bias; their sums see σ itself, 1e-4 of
    # motions of 0.1 m. 0.1: between the two by a wide margin on both sides.
    assert summed < 0.1 * alone
    assert summed < 10 * error(given, exact, 1e-5, Treatment(1, True)) * 2  # in proportion to the noise


# --- which steps can be in balance: linear systems of which some steps are wrong


def none_of(count):
    """Values of one family."""
    return np.zeros(count, np.int32)


class Dense:
    """Equations C q = r of S steps with N rows each."""

    def __init__(self, C, r):
        self.C, self.r, self.counts = C, r, np.full(len(C), C.shape[1])
        self.Q, self.agreed, self.own, self.anchor = C.shape[2], None, False, np.zeros(0)

    def sizes(self, q):
        away, terms = self.r - self.C @ q, np.abs(self.C) @ np.abs(q)
        return np.linalg.norm(away, axis=1), np.linalg.norm(terms, axis=1)

    def patches(self, size, most):
        steps, one = np.arange(len(self.C)), np.eye(self.Q)
        yield 0, [Patch(steps, self.C, self.r, np.zeros(self.Q), one, none_of(self.Q))]

    def gram(self, kept):
        C = self.C[kept].reshape(-1, self.C.shape[2])
        return csr_array(C.T @ C)

    def right(self, q, kept):
        away = self.r[kept] - self.C[kept] @ q
        return self.C[kept].reshape(-1, self.C.shape[2]).T @ away.ravel()


def kept_of(C, r):
    rows, every = Dense(C, r), np.ones(len(C), bool)
    return trimmed(rows, every, rows.gram(every).toarray())


@pytest.mark.parametrize(("out", "noise", "kept"), [(4, 0.03, 36), (15, 0.03, 40), (15, 1e-5, 25), (25, 1e-5, 15)])
def test_what_is_left_out_is_little_unless_the_rest_is_exact(out, noise, kept):
    # of 15 exceptions among 40 nobody can say that they are exceptions, but where the others leave nothing
    rng = np.random.default_rng(4)
    C, q = rng.normal(size=(40, 30, 5)), rng.normal(size=5)
    r = C @ q + noise * rng.normal(size=(40, 30))
    r[:out] += rng.normal(size=(out, 30))
    assert kept_of(C, r).sum() == kept


def test_a_step_that_agrees_in_a_patch_is_left_out_where_the_rest_of_the_cloth_does_not():
    # 18 steps of 40 by a patch, of which one has rows of twice the size and values 4 % off; rounding leaves 0.1 %
    rng = np.random.default_rng(0)
    C, q, agreed = rng.normal(size=(40, 30, 5)), rng.normal(size=5), np.arange(40) < 18
    C[17] *= 2.0
    r = C @ q + 1e-3 * rng.normal(size=(40, 30))
    r[17] = 1.04 * (C[17] @ q)
    r[18:] += rng.normal(size=(22, 30))
    rows = Dense(C, r)
    assert np.flatnonzero(balanced_beside(rows, rows.counts > 0, agreed)).tolist() == list(range(17))


@pytest.mark.parametrize(("steps", "count"), [(10, 0), (0, 2), (2, 2)])
def test_a_patch_of_no_value_or_too_few_steps_says_nothing(steps, count):
    every, base = np.arange(steps, dtype=np.int32), np.ones(4)
    patch = Patch(every, np.ones((steps, 6, 4)), np.ones((steps, 6)), base, np.ones((4, count)), none_of(4))
    assert not agreeing(patch).steps.any()


@pytest.mark.parametrize(("moves", "own"), [(True, True), (False, False)])
def test_few_steps_in_balance_show_whose_they_are_but_for_those_of_a_cloth_at_rest(moves, own):
    rng = np.random.default_rng(6)
    C, q = rng.normal(size=(40, 6, 20)), rng.normal(size=20)
    r = C @ q + rng.normal(size=(40, 6))
    C[5:14] = C[5:14] if moves else C[5]  # some values balance any shape that stays
    r[5:14] = C[5:14] @ q
    found = agreeing(Patch(np.arange(40, dtype=np.int32), C, r, np.zeros(20), np.eye(20), none_of(20)))
    assert not found.steps.any()  # 9 of 40 are too few to go by
    assert found.own is own


@pytest.mark.parametrize(("noise", "kept"), [(0.0, 14), (1e-4, 0)])
def test_few_steps_are_enough_where_they_agree_exactly(noise, kept):
    rng = np.random.default_rng(8)
    C, q = rng.normal(size=(100, 6, 20)), rng.normal(size=20)
    r = C @ q + rng.normal(size=(100, 6))
    r[30:44] = C[30:44] @ q + noise * rng.normal(size=(14, 6))  # 84 rows for 20 values, of a seventh of the steps
    found = agreeing(Patch(np.arange(100, dtype=np.int32), C, r, np.zeros(20), np.eye(20), none_of(20))).steps
    assert found[30:44].sum() == found.sum() == kept


def test_three_steps_that_follow_one_another_are_enough_to_begin_with():
    rng = np.random.default_rng(10)
    C, q = rng.normal(size=(60, 6, 16)), rng.normal(size=16)
    r = C @ q + rng.normal(size=(60, 6))
    places = (np.arange(5, 50, 10)[:, None] + np.arange(3)).ravel()  # 18 rows for 16 values, five times
    r[places] = (C @ q)[places]
    found = agreeing(Patch(np.arange(60, dtype=np.int32), C, r, np.zeros(16), np.eye(16), none_of(16)))
    assert np.flatnonzero(found.steps).tolist() == places.tolist()
    assert found.own


@pytest.mark.parametrize("length", [8, 30])
def test_rounded_steps_agree_by_runs_that_are_long_enough(length):
    rng = np.random.default_rng(9)
    C, q = rng.normal(size=(60, 6, 20)), rng.normal(size=20)
    C[:, :, 10:] *= 1e-2  # values that a few rows hardly show
    r = C @ q + rng.normal(size=(60, 6))
    places = np.concatenate([np.arange(length), np.arange(35, 60 - (length - 8))])
    r[places] = (C @ q + 3e-4 * rng.normal(size=(60, 6)))[places]
    found = agreeing(Patch(np.arange(60, dtype=np.int32), C, r, np.zeros(20), np.eye(20), none_of(20))).steps
    assert np.flatnonzero(found).tolist() == places.tolist()


@pytest.mark.parametrize("first", [0, 10, 22])
def test_steps_that_agree_with_one_another_are_not_taken_for_the_rest(first):
    # 18 steps in a row follow another law, with larger rows: the balance of all steps is nearer to theirs
    rng = np.random.default_rng(7)
    C, q = rng.normal(size=(40, 30, 5)), rng.normal(size=5)
    C[first : first + 18] *= 30.0
    r = C @ q
    r[first : first + 18] = C[first : first + 18] @ (q + 1.0) + rng.normal(size=(18, 30))
    wrong = np.zeros(40, bool)
    wrong[first : first + 18] = True
    np.testing.assert_array_equal(kept_of(C, r), ~wrong)


@pytest.mark.parametrize(("rounding", "kept"), [(1e-10, 40), (1e-6, 36)])
def test_residuals_that_are_nothing_beside_what_they_are_left_of_put_no_step_out(rounding, kept):
    rng = np.random.default_rng(5)
    C, q = rng.normal(size=(40, 30, 5)), rng.normal(size=5)
    size = np.repeat([1e4, 1.0], [4, 36])[:, None]  # the first steps were solved less accurately
    r = C @ q + rounding * size * rng.normal(size=(40, 30))
    assert kept_of(C, r).sum() == kept


# --- steps of other forms


def shaking(side, delta):
    """A light sheet without damping or air, of steps so long that every other one would add energy."""
    mesh = plane(side - 2, 2.1)
    made, z = springs(mesh, 1.0), mesh.positions[:, 2]
    own = object_document(mesh, z == z.max(), density=0.1, stiffness=1.0, damping=0.0, drag=0.0, settings="nL")
    stiffness = {"springStiffness": np.where(made.bends, 12.5, 50.0).tolist()}
    still = {"integrationMethod": METHODS["bdf2"], "delta": delta, "windVel": xyz((0, 0, 0))}
    return scene(own | stiffness, **still, optimizationIterations=40, forwardSubSteps=1, tolerance=TIGHT)


@pytest.mark.parametrize(("side", "delta"), [(12, 0.07), (20, 0.05)])  # some shortened, and some clamped
def test_steps_of_every_form_are_balances_once_it_is_known(side, delta):
    given = shaking(side, delta)
    system = build(given, 0)
    memory, _ = rollout(system, 39, TIGHT)
    forms, seen = forms_of([memory]), Track(memory.x, np.ones(memory.x.shape[:2], bool))
    assert forms.clamped.any() or (forms.theta < 1.0).any()
    none = csr_array((len(system.x0) + len(system.springs.rest), 1))
    one = none_of(len(system.springs.rest))
    found = [Rows(balances(system, seen, forms=each), system, none, one) for each in (None, forms)]
    plain, away = (relative(*each.sizes(np.zeros(1)))[1:] for each in found)  # in the first step all forces are zero
    assert (plain > 1e-3).mean() > 0.5  # a third of them Euler steps, each in three balances
    assert away.max() < 1e-10  # linear systems solved to TIGHT, of forces that nearly cancel


def test_rows_that_do_not_count_add_nothing():
    given = shaking(12, 0.07)
    system = build(given, 0)
    memory, _ = rollout(system, 39, TIGHT)
    count, rng = len(system.x0) + len(system.springs.rest), np.random.default_rng(2)
    made = balances(system, Track(memory.x, np.ones(memory.x.shape[:2], bool)))
    rows = Rows(made, system, csr_array(np.eye(count)), none_of(len(system.springs.rest)))
    kept, d, every = rng.random(made.valid.shape) < 0.5, rng.standard_normal(count), np.ones(39, bool)
    rows.keep(kept)
    left = np.array([rows.left(t, d) for t in range(39)])
    assert not left[~kept].any()
    assert left[kept & made.valid].all(axis=1).any()
    # the same sum of squares by CᵀC; products of 1e3 rows
    assert d @ (rows.gram(every) @ d) == pytest.approx(rows.squares_along(0.0 * d, d, every)[0], rel=1e-12)


@pytest.mark.parametrize(("side", "delta"), [(12, 0.07), (20, 0.05)])
def test_values_show_the_forms_of_steps_and_these_better_values(side, delta):
    given = shaking(side, delta)
    p, kept, _ = fitted(given, start=np.full(len(parameters(given)), 20.0))
    assert_allclose(p[kept], parameters(given)[kept], rtol=1e-8)  # 7e-1 and more with plain steps alone


# --- the balances: the step's own residual, linear in masses and stiffnesses


def on_a_sphere(method="implicit", newton=1, nx=3, frames=8, **fields):
    """A heavy cloth in the wind, on a sphere."""
    return made(sheet("LL", nx, 3, **fields), method=method, newton=newton, frames=frames, **SPHERE)


def rows(method, newton, vary=None, frames=8):
    """The balances of a small cloth along its own motion, for other elements where `vary` changes them."""
    given = on_a_sphere(method, newton, frames=frames)
    aim = Objective(given, simulate(given, tolerance=TIGHT), TIGHT)
    (run,) = aim.runs
    system = run.system if vary is None else with_elements(run.system, vary(all_elements(run.system)))
    return balances(system, track(run.comparison.goal, system)), system


@pytest.mark.parametrize(("method", "lost_rows"), [("implicit", [3, 4, 5]), ("bdf2", [3, 4, 5, 6, 7])])
def test_rows_that_a_hidden_vertex_touches_are_not_valid(method, lost_rows):
    given = on_a_sphere(method, nx=4, frames=9, triangles=[], dragCoefficient=0.0)
    motion = simulate(given, tolerance=TIGHT)
    where = np.zeros((9, 12), bool)
    where[4, 11] = True
    (run,) = Objective(given, hide(motion, where), TIGHT).runs
    found = balances(run.system, track(run.comparison.goal, run.system))
    ends = run.system.springs.ends
    near = sorted({11, *ends[(ends == 11).any(axis=1)].ravel().tolist()})
    lost = np.argwhere(~found.valid & run.system.vertex.free)
    # the steps from 3 to 4 and from 4 to 5, and those after, whose velocities before the step need frame 4
    assert sorted(set(lost[:, 0].tolist())) == lost_rows
    assert sorted(set(lost[:, 1].tolist())) == near


def test_a_patch_of_which_no_step_shows_all_vertices_agrees_on_nothing():
    found, system = rows("implicit", 1)
    found.valid[::2, 4] = found.valid[1::2, 5] = False
    size = len(system.vertex.mass) + len(system.springs.rest)
    patch = Rows(found, system, csr_array(np.eye(size)), none_of(len(system.springs.rest))).patch(np.array([4, 5]))
    assert agreeing(patch).steps.tolist() == []


@pytest.mark.parametrize("frames", [2, 3, 8])
def test_rows_have_one_order_however_few_steps_there_are(frames):
    """What is in another order has another type, for which the kernel would be compiled again."""
    found, _ = rows("implicit", 1, frames=frames)
    assert all(array.flags.c_contiguous for array in found)


def test_sums_of_sums_end_at_the_first_gap():
    found, system = rows("implicit", 1)
    valid = found.valid.copy()
    valid[3, 5] = False
    twice = summed_twice(found._replace(valid=valid))
    assert twice.valid[:, 5].tolist() == [True] * 3 + [False] * 4
    assert twice.valid[:, 4].all()
    by_hand = sum((7 - 1 - t) * found.mass[t, 4] for t in range(7)) + found.mass[:, 4].sum(axis=0)
    np.testing.assert_allclose(twice.mass[-1, 4], by_hand, rtol=1e-12)  # rounding
    spring = int(np.flatnonzero((system.springs.ends == 4).any(axis=1))[0])
    expected = np.cumsum(np.cumsum(found.stiffness[:, spring], axis=0), axis=0)
    np.testing.assert_allclose(twice.stiffness[:, spring], expected, rtol=1e-12, atol=1e-18)


def test_smoothing_leaves_a_parabola_alone():
    t = np.arange(20.0)[:, None, None]
    x = np.ones((1, 3, 3)) + 0.3 * t - 0.02 * t**2
    seen = np.ones((20, 3), bool)
    seen[8, 1] = False
    found = smoothed(Track(x, seen), x[0], 7)
    np.testing.assert_allclose(found.x, x, rtol=1e-12)  # rounding
    assert np.flatnonzero(~found.seen[:, 1]).tolist() == [5, 6, 7, 8, 9, 10, 11]
    assert found.seen[:, 0].all()
    short = Track(x[:5], seen[:5])
    assert smoothed(short, x[0], 7) is short


def test_steps_that_rounding_hides_from_single_values_agree_by_families():
    """Half of them are out of balance, here and there; the others by a part in a thousand."""
    rng = np.random.default_rng(5)
    T, R, K = 60, 36, 90
    entries, family = rng.standard_normal((T, R, K)), np.repeat([0, 1], K // 2).astype(np.int32)
    terms = entries @ np.where(family, 3.0, 2.0)
    good = rng.random(T) < 0.5
    off = np.where(good, 2e-3, 1.0)[:, None] * rng.standard_normal((T, R)) * np.linalg.norm(terms, axis=1)[:, None]
    patch = Patch(np.arange(T, dtype=np.int32), entries, terms + off, np.ones(K), np.eye(K), family)
    assert patch.by_families.spread.shape == (K, 2)
    assert not agreeing(patch).steps.any()  # runs of 3 steps have 1.2 rows for each value
    assert np.array_equal(agreeing(patch.by_families, rough=True).steps, good)
