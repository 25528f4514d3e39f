"""The momentum fit: parameters straight from an exact motion, and what noise and gaps leave of them."""

import numpy as np
import pytest
from helpers.marks import compiled
from helpers.physics import METHODS, TIGHT, ball, scene, xyz
from helpers.scenes import cloth

from clothfit.engine.rollout import rollout
from clothfit.engine.system import build
from clothfit.motion.degrade import degrade
from clothfit.motion.divergence import Diverged
from clothfit.motion.motion import Motion
from clothfit.motion.simulate import simulate
from clothfit.objective.objective import Objective
from clothfit.optimise import momentum
from clothfit.optimise.balances import Equations
from clothfit.optimise.momentum import ANCHORED, TREATMENTS, Treatment, in_balance
from clothfit.scene.fit_vector import parameters

pytestmark = pytest.mark.slow  # compiles a fit

VARIANTS = [("explicit", 1), ("symplectic", 1), ("implicit", 1), ("implicit", 12), ("bdf2", 1), ("bdf2", 12)]
AIR = {"windVel": xyz((4, 2, -3))}
SPHERE = {"colliders": [ball((1.0, -0.748, 1.0), 0.75)]}
FRAMES = 25


def sheet(settings="LL", nx=4, ny=4, alike=False, **fields):
    """A heavy cloth in motion, in the air; with one mass and one stiffness all over where all are `alike`."""
    n, springs = nx * ny, len(cloth(nx, ny)["springStiffness"])
    rng = np.random.default_rng(31)
    made = {
        "vertMass": [0.06] * n if alike else rng.uniform(0.04, 0.08, n).tolist(),
        "springStiffness": [30.0] * springs if alike else rng.uniform(15.0, 60.0, springs).tolist(),
        "dragCoefficient": 0.3,
        "damping": 0.2,
        "optimizationSettings": settings,
    }
    return cloth(nx, ny, **{**made, **fields})


def made(*objects, method="implicit", newton=1, frames=FRAMES, **fields):
    delta = 0.02 if method in ("implicit", "bdf2") else 0.005
    chosen = {"integrationMethod": METHODS[method], "forwardSubSteps": newton, "delta": delta}
    return scene(*objects, **{**chosen, "optimizationIterations": frames, "tolerance": 1e-13, **AIR, **fields})


def fitted(given, motion=None, treatment=TREATMENTS[0], start=None):
    """The fit of a scene's own motion from another start, and what was fitted (P,)."""
    aim = Objective(given, simulate(given, tolerance=TIGHT) if motion is None else motion, TIGHT)
    p = parameters(given)
    away = np.exp(0.5 * np.random.default_rng(1).normal(size=len(p))) * p if start is None else start
    return momentum.fit(aim, away, aim.identifiable, treatment), aim.identifiable, away


# --- exact targets


@compiled
@pytest.mark.parametrize(("method", "newton"), VARIANTS)
@pytest.mark.parametrize("settings", ["nL", "Ln", "LL"])
def test_every_element_comes_out_of_an_exact_motion(settings, method, newton):
    given = made(sheet(settings), method=method, newton=newton)
    p, kept, away = fitted(given)
    # velocities are differences of metres over h, and accelerations over h²: 1e-16 / 4e-4 against 1 … 10, and worse
    # for springs that hardly stretch
    np.testing.assert_allclose(p[kept], parameters(given)[kept], rtol=1e-6)
    np.testing.assert_array_equal(p[~kept], away[~kept])


@compiled
@pytest.mark.parametrize(("method", "newton"), VARIANTS)
@pytest.mark.parametrize("settings", ["nG", "Gn", "GG", "GL", "LG"])
def test_one_value_for_all_comes_out_where_it_is_one(settings, method, newton):
    given = made(sheet(settings, alike=True), method=method, newton=newton)
    p, kept, _ = fitted(given)
    np.testing.assert_allclose(p[kept], parameters(given)[kept], rtol=1e-6)  # as above


@compiled
@pytest.mark.parametrize("method", METHODS)
def test_on_a_sphere(method):
    given = made(sheet(nx=3, ny=3), method=method, **SPHERE)
    p, kept, _ = fitted(given)
    np.testing.assert_allclose(p[kept], parameters(given)[kept], rtol=1e-6)  # as above


@compiled
def test_several_cloths_each_by_its_own_rows():
    given = made(sheet("LL", 3, 3), sheet("nn", 3, 4), sheet("nG", 3, 3, alike=True), sheet("Ln", 2, 3))
    p, kept, _ = fitted(given)
    np.testing.assert_allclose(p[kept], parameters(given)[kept], rtol=1e-6)  # as above


@compiled
def test_several_experiments_add_their_rows():
    # too few frames in each: 14 free vertices give 84 equations for 47 unknowns, badly; all three of them do better
    given = made(sheet(), frames=4)
    scenes = [made(sheet(), frames=12, windVel=xyz(wind)) for wind in ((4, 2, -3), (-8, 5, 1), (0, -9, 6))]
    motions = [(simulate(one, tolerance=TIGHT), one) for one in scenes]
    p, kept, _ = fitted(given, motions)
    np.testing.assert_allclose(p[kept], parameters(given)[kept], rtol=1e-6)  # as above


@compiled
def test_without_air_masses_and_stiffnesses_keep_their_common_factor():
    given = made(sheet(nx=3, ny=3, dragCoefficient=0.0))
    p, kept, away = fitted(given)
    # Balances without a right-hand side: the answer nearest to the start is 0 but for what the start keeps of it.
    ratio = p[kept] / parameters(given)[kept]
    np.testing.assert_allclose(ratio, ratio[0], rtol=1e-5)
    assert np.linalg.norm(away[kept]) > np.linalg.norm(p[kept] - away[kept]) > 0
    assert ratio[0] > 0


@compiled
@pytest.mark.parametrize(("delta", "shortened"), [(0.03, 0), (0.04, 1)])
def test_steps_that_the_guard_made_otherwise_are_left_out(delta, shortened):
    stiffness = np.random.default_rng(3).uniform(500, 1500, 56).tolist()
    hung = {"vertIsFixed": [i < 5 for i in range(25)], "springStiffness": stiffness, "damping": 0.02}
    one = sheet("nL", 5, 5, dragCoefficient=0.0, **hung)
    given = made(one, method="bdf2", frames=60, delta=delta)
    memory, _ = rollout(build(given, 0), 59, TIGHT)
    assert (memory.euler.sum() > 1, (memory.theta < 1).sum()) == (True, shortened)  # it whips through
    p, kept, _ = fitted(given)
    np.testing.assert_allclose(p[kept], parameters(given)[kept], rtol=1e-6)  # as above


@compiled
def test_steps_that_were_taken_otherwise_are_balanced_as_they_were_taken():
    high = 0.02 * np.random.default_rng(8).normal(size=32)[16:]
    lying = [xyz((i % 4, float(high[i]), i // 4)) for i in range(16)]
    stiffness = np.linspace(1000.0, 2000.0, 33).tolist()
    free = {"damping": 0.0, "dragCoefficient": 0.0, "vertIsFixed": [i < 4 for i in range(16)]}
    one = sheet("nL", vertPos=lying, vertMass=[0.02] * 16, springStiffness=stiffness, **free)
    given = made(one, delta=0.1, frames=40)
    memory, _ = rollout(build(given, 0), 39, TIGHT)
    otherwise = memory.clamped | (memory.theta < 1)
    assert memory.clamped.any()
    assert (memory.theta < 1).any()
    aim, p = Objective(given, simulate(given, tolerance=TIGHT), TIGHT), parameters(given)
    column = np.where(aim.identifiable, np.cumsum(aim.identifiable) - 1, -1).astype(np.int32)
    part = momentum.rows_of(aim, aim.runs[0], p, list(aim.blocks), column, TREATMENTS[0])
    rows, truth = Equations([part[0]]), np.zeros(int(aim.identifiable.sum()))
    good = in_balance(rows, rows.counts > 0, truth)
    np.testing.assert_array_equal(good, ~otherwise)
    assert momentum.reformed([part], rows, truth, good).all()
    size, terms = rows.sizes(truth)
    assert (size <= 1e-10 * terms).all()  # rounding of positions over h² beside the terms of springs


@compiled
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


# --- targets with gaps


def hide(motion, where):
    """The motion without the vertices of `where` (frames, vertices)."""
    return Motion(np.where(where[:, :, None], np.nan, motion.positions), motion.times, motion.vertex_counts, ~where)


@compiled
def test_gaps_are_passed_over_while_enough_is_left():
    given = made(sheet("nL"), frames=120)
    motion = simulate(given, tolerance=TIGHT)
    where = np.random.default_rng(9).uniform(size=motion.positions.shape[:2]) < 0.05
    p, kept, _ = fitted(given, hide(motion, where))
    np.testing.assert_allclose(p[kept], parameters(given)[kept], rtol=1e-6)  # as above


@compiled
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


@compiled
@pytest.mark.parametrize("change", [{"every": 2}, {"every": 3}])
def test_without_successive_frames_everything_stays(change):
    given = made(sheet())
    motion = degrade(simulate(given, tolerance=TIGHT), **change)
    p, _, away = fitted(given, motion)
    np.testing.assert_array_equal(p, away)


@compiled
def test_frames_between_the_steps_are_passed_over():
    given = made(sheet())
    motion = simulate(given, tolerance=TIGHT)
    between = Motion(0.5 * (motion.positions[1:] + motion.positions[:-1]), motion.times[:-1] + 0.01, (16,))
    p, _, away = fitted(given, between)
    np.testing.assert_array_equal(p, away)


@compiled
def test_what_is_not_to_be_fitted_stays():
    given = made(sheet())
    aim, p = Objective(given, simulate(given, tolerance=TIGHT), TIGHT), parameters(given)
    some = aim.identifiable.copy()
    some[::2] = False
    away = np.where(some, 1.5 * p, p)
    found = momentum.fit(aim, away, some)
    np.testing.assert_array_equal(found[~some], p[~some])
    np.testing.assert_allclose(found[some], p[some], rtol=1e-6)  # as above


@compiled
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


@compiled
@pytest.mark.parametrize("settings", ["nL", "LL"])
def test_sums_of_sums_take_noise_for_what_it_is(settings):
    given = made(sheet(settings), frames=100)
    exact = simulate(given, tolerance=TIGHT)
    alone, summed = (error(given, exact, 1e-4, Treatment(1, chosen)) for chosen in (False, True))
    # Rows alone see σ/h² (1e-4 over 4e-4 of accelerations of 10), squared by its bias; their sums see σ itself, 1e-4 of
    # motions of 0.1 m. 0.1: between the two by a wide margin on both sides.
    assert summed < 0.1 * alone
    assert summed < 10 * error(given, exact, 1e-5, Treatment(1, True)) * 2  # in proportion to the noise


@compiled
def test_smoothing_helps_against_much_noise():
    given = made(sheet("LL"), frames=100)
    exact = simulate(given, tolerance=TIGHT)
    alone, smooth = (error(given, exact, 1e-2, Treatment(frames, True)) for frames in (1, 7))
    assert smooth < 0.85 * alone  # the noise within the forces is less, by less than the root of seven frames


@compiled
def test_a_target_that_diverges_nobody_simulates():
    given = made(sheet("nL", nx=3, ny=3), method="explicit")
    motion = simulate(given, tolerance=TIGHT)
    stiff = scene(sheet("nL", nx=3, ny=3, springStiffness=[9e3] * 16), integrationMethod=0, delta=0.005, **AIR)
    with pytest.raises(Diverged):
        simulate(stiff)
    aim = Objective(made(sheet("nL", nx=3, ny=3, springStiffness=[9e3] * 16), method="explicit"), motion, TIGHT)
    found = momentum.fit(aim, np.full(16, 9e3), aim.identifiable)
    kept = aim.identifiable
    np.testing.assert_allclose(found[kept], parameters(given)[kept], rtol=1e-6)  # as above
