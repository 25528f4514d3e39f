"""Inputs over time: frames of reference that move, files, and motions with all inputs at once."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.physics import METHODS, VARIANTS, ball, chain, keys, scene, sheet, xyz

from clothfit import InvalidScene, energies, estimate, load, save, simulate
from clothfit.engine.inputs import knots, sampling
from clothfit.engine.inputs.files import loaded
from clothfit.engine.inputs.interpolation import interpolated
from clothfit.engine.system import build
from clothfit.evaluation.reference import converged
from clothfit.formats import point_cache
from clothfit.formats.animation import Animation
from clothfit.formats.axes import RIGHT, from_scene
from clothfit.optimise.balances import Track, balances
from clothfit.scene.keys import Keys

TIGHT = 1e-13


def hung(method="implicit", newton=1, pins=(), steps=20, **fields):
    """A hanging chain of five vertices, the first one held; fields of the object in `own`."""
    own = fields.pop("own", {})
    one = chain(5, "nn", fixed=(0,), **{"damping": 0.2, "pins": list(pins), **own})
    whole = {"delta": 0.01, "tolerance": TIGHT, "optimizationIterations": steps + 1, **fields}
    return scene(one, integrationMethod=METHODS[method], forwardSubSteps=newton, **whole)


@pytest.mark.slow
@pytest.mark.parametrize(("method", "newton"), VARIANTS)
def test_a_motion_is_the_same_seen_from_a_frame_that_moves_evenly(method, newton):
    path = {"vertices": [0], "posKeys": keys([0, 10], [(0, 0, 0), (7, -3, 5)])}
    ride = np.array([0.7, -0.3, 0.5])
    # the vertices' own damping is that of air at rest: springs alone see no difference, and theirs comes with it
    still = simulate(hung(method, newton, own={"damping": 0.0}))
    carried = simulate(hung(method, newton, [path], own={"vertVel": [xyz(ride)] * 5, "damping": 0.0}))
    # but for the rounding of some thousand operations and the tolerance of the linear solver
    np.testing.assert_allclose(carried.positions - carried.times[:, None, None] * ride, still.positions, atol=1e-10)


@pytest.mark.slow
def test_a_pendulum_on_an_accelerated_frame_feels_another_gravity():
    h, steps, a = 0.01, 20, np.array([4.0, 1.0, -2.0])
    n = np.arange(steps + 1)
    # as backward Euler integrates a constant acceleration from rest: differences h² a n
    path = {"vertices": [0], "posKeys": keys(h * n, 0.5 * h * h * (n * (n + 1))[:, None] * a)}
    moved = simulate(hung("implicit", 1, [path], own={"damping": 0.0}))
    tilted = simulate(hung("implicit", 1, gravity=xyz(np.array([0, -9.81, 0]) - a), own={"damping": 0.0}))
    seen = moved.positions - 0.5 * h * h * (n * (n + 1))[:, None, None] * a
    np.testing.assert_allclose(seen, tilted.positions, atol=1e-10)


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
def test_pins_are_on_their_path_at_every_frame(method):
    turn = {"vertices": [0, 1], "rotKeys": keys([0, 0.2], [(0, 0, 0), (0, 0, 90)]), "pivot": xyz((0, 1, 0))}
    one = chain(5, "nn", fixed=(0, 1), pins=[turn])
    made = scene(one, integrationMethod=METHODS[method], delta=0.01, optimizationIterations=21)
    motion = simulate(made)
    angle = np.radians(90) * motion.times / 0.2
    start = np.array([[0.0, -1.0, 0.0], [1.0, -1.0, 0.0]])  # from the pivot
    x = np.cos(angle)[:, None] * start[:, 0] - np.sin(angle)[:, None] * start[:, 1]
    y = np.sin(angle)[:, None] * start[:, 0] + np.cos(angle)[:, None] * start[:, 1]
    np.testing.assert_allclose(motion.positions[:, :2, 0], x, atol=1e-14)
    np.testing.assert_allclose(motion.positions[:, :2, 1], 1.0 + y, atol=1e-14)


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
def test_keys_that_stay_are_the_constant_value(method):
    fields = {"dragCoefficient": 0.3}
    made = {"integrationMethod": METHODS[method], "delta": 0.005, "optimizationIterations": 11, "tolerance": TIGHT}
    plain = scene(sheet("nn", **fields), windVel=xyz((3, 1, -2)), gravity=xyz((1, -9, 2)), **made)
    keyed = scene(
        sheet("nn", **fields), windVel=xyz((1, 1, 0)), windVelKeys=keys([0], [(2, 0, -2)]),
        gravity=xyz((1, 0, 0)), gravityKeys=keys([0], [(0, -9, 2)]), **made,
    )  # fmt: skip
    a, b = simulate(plain), simulate(keyed)
    np.testing.assert_allclose(a.positions, b.positions, atol=1e-12)  # a sum of two numbers is rounded
    for one, other in zip(vars(energies(plain, a)).values(), vars(energies(keyed, b)).values(), strict=True):
        np.testing.assert_allclose(one, other, atol=1e-10)


def rich(method="implicit", newton=1):
    """A cloth with pins that turn, wind, gravity and a sphere over time."""
    one = sheet("nn", vertIsFixed=[i in (0, 1, 2) for i in range(9)])
    one["vertVel"] = [xyz((0.1 * i, 0, -0.1)) for i in range(9)]
    one["pins"] = [
        {"vertices": [0, 2], "rotKeys": keys([0, 0.03], [(0, 0, 0), (20, 40, 10)], interpolation="smooth")},
        {"vertices": [1], "posKeys": keys([0, 0.02, 0.04], [(0, 0, 0), (0.02, 0.05, 0), (0, 0, 0)])},
    ]
    moving = {**ball((1.0, -0.748, 1.0), 0.75), "posKeys": keys([0, 0.05], [(0, 0, 0), (0.01, 0.02, 0)])}
    return scene(
        one, integrationMethod=METHODS[method], forwardSubSteps=newton, delta=0.01, optimizationIterations=6,
        windVel=xyz((4, -2, -3)), windVelKeys=keys([0, 0.03], [(0, 0, 0), (-8, 1, 2)]), colliders=[moving],
        gravityKeys=keys([0.01, 0.02], [(0, 0, 0), (3, 1, 0)], interpolation="hold"), tolerance=TIGHT,
    )  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize(("method", "newton"), [*VARIANTS[:3], ("implicit", 12), ("bdf2", 1), ("bdf2", 12)])
def test_momentum_is_balanced_with_all_inputs(method, newton):
    made = rich(method, newton)
    motion, system = simulate(made), build(made, 0)
    rows = balances(system, Track(motion.positions, np.ones(motion.positions.shape[:2], bool)))
    left = np.where(rows.valid[..., None], rows.residual, 0.0)
    assert rows.valid.sum() >= 20
    # velocities are differences of positions, 1e-16 m over 0.01 s, of masses of 0.01 kg; with some of the Jacobian left
    # out, twelve of Newton's iterations end at 1e-10 of a momentum of about 1 N s
    assert np.abs(left).max() < (1e-12 if newton == 1 else 1e-9)


@pytest.mark.slow
def test_a_fit_finds_the_wind_over_time(tmp_path):
    wind = keys([0, 0.04, 0.08], [(1, 3, -2), (-2, 5, 1), (2, -3, 4)])
    made = scene(
        sheet("nn", dragCoefficient=0.3), delta=0.01, optimizationIterations=11, tolerance=TIGHT, windVelKeys=wind,
        fit={"windVelKeys": "L"},
    )  # fmt: skip
    found = estimate(made, simulate(made), start=0.5)
    # a flat cloth shows only the wind across it at first, and of the first key there is little else; the others are
    # seen in positions that are exact to 1e-13 m
    np.testing.assert_allclose(found.scene.gusts[1:], made.gusts[1:], atol=1e-3)
    assert found.rmse < 1e-8
    save(found.scene, tmp_path / "found.json")
    np.testing.assert_array_equal(load(tmp_path / "found.json").gusts, found.scene.gusts)


@pytest.mark.slow
def test_a_converged_motion_has_the_inputs_of_its_time():
    made = rich()
    reference = converged(made, 4, error=1e-4)
    fine = simulate(made.with_step(made.delta / 512, 3 * 512 + 1))
    extent = np.ptp(fine.positions, axis=0).max()
    # steps of 20 µs of first order; the reference is extrapolated from ones of its own
    assert np.abs(reference.positions - fine.positions[::512]).max() < 5e-3 * extent


def sampled(interpolation, times, values, at):
    """Keys of one number at some times."""
    three = np.asarray(values, float)[:, None] * np.ones(3)
    return sampling.interpolated(Keys(np.array(times, float), three, interpolation), np.array(at, float))[:, 0]


def test_interpolation():
    at = [-1.0, 0.0, 0.5, 1.0, 1.5, 3.0, 9.0]
    assert sampled("linear", [0, 1, 3], [0, 2, 6], at).tolist() == [0, 0, 1, 2, 3, 6, 6]
    assert sampled("hold", [0, 1, 3], [0, 2, 6], at).tolist() == [0, 0, 0, 2, 2, 6, 6]
    assert sampled("smooth", [0, 1, 3], [0, 2, 6], [-1, 0, 1, 3, 9]).tolist() == [0, 0, 2, 6, 6]
    # the cubic that is at rest at both ends: t² (3 − 2 t)
    t = np.linspace(0, 1, 11)
    np.testing.assert_allclose(sampled("smooth", [0, 1], [0, 1], t), t * t * (3 - 2 * t), atol=1e-15)
    assert sampled("linear", [2], [5], at).tolist() == [5] * 7


@pytest.mark.parametrize(("times", "value"), [([0.0, 1e-310], 1.0), ([0.0, 0.02], 1.7e308)])
def test_a_smooth_curve_whose_slopes_overflow_is_refused(times, value):
    with pytest.raises(InvalidScene, match=r"^frame\.posKeys: the values change too much in too short a time"):
        sampling.interpolated(
            Keys(np.array(times), value * np.eye(2, 3), "smooth", place="frame.posKeys"), np.zeros(1)
        )


def test_a_smooth_rotation_that_is_not_found_is_refused():
    """Turns of up to half a circle in a microsecond: the iterations for the rates at the keys grow without bounds."""
    g = np.random.default_rng(0)
    times, angles = np.cumsum(np.where(g.random(12) < 0.5, 1e-6, 0.1)), g.uniform(-180, 180, (12, 3))
    with pytest.raises(InvalidScene, match=r"^frame\.rotKeys: no smooth rotation goes through keys"):
        sampling.turned(Keys(times, angles, "smooth", place="frame.rotKeys"), np.zeros(1))


def test_a_smooth_rotation_goes_through_unevenly_spaced_keys():
    """SciPy's spline of rates misses some of these sets, by up to half a turn, or raises."""
    for seed in (5, 16, 33, 49):
        g = np.random.default_rng(seed)
        times, angles = np.sort(g.uniform(0, 4, 200)), g.uniform(-30, 30, (200, 3))
        found = sampling.turned(Keys(times, angles, "smooth", place="frame.rotKeys"), times)
        turns = sampling.rotation(angles)
        np.testing.assert_allclose(found, (turns * turns[0].inv()).as_matrix(), atol=1e-6)  # `MISSED`
        when = np.linspace(times[0], times[-1], 2000)
        between = sampling.turned(Keys(times, angles, "smooth", place="frame.rotKeys"), when)
        farthest = (turns * turns[0].inv()).magnitude().max()
        # each coordinate of a rotation vector stays between those of its keys, so all three are at most √3 times that
        assert np.arccos((np.trace(between, axis1=1, axis2=2) - 1) / 2).max() <= np.sqrt(3) * farthest


def test_only_paths_of_pins_have_several_points(tmp_path):
    file = tmp_path / "k.npz"
    np.savez(file, times=[0.0, 0.1], positions=np.zeros((2, 4, 3)))
    for place in ("windVelKeys", "gravityKeys", "frame.rotKeys", "objects[0].pins[1].rotKeys", "colliders[0].posKeys"):
        keys = Keys(np.zeros(0), np.zeros((0, 3)), file=str(file), place=place)
        with pytest.raises(InvalidScene, match=r"has 4 points, and one vector is needed"):
            loaded(keys)
        assert loaded(replace(keys, points=(2,))).values.shape == (2, 3)
    assert loaded(replace(keys, place="objects[0].pins[12].posKeys")).values.shape == (2, 4, 3)


def test_angles_turn_as_in_unity():
    # Quaternion.Euler(0, 90, 0) turns forward (z) to the right (x), Euler(90, 0, 0) turns it down; z, then x, then y
    forward = np.array([0.0, 0.0, 1.0])
    np.testing.assert_allclose(sampling.rotation(np.array([0, 90, 0])).apply(forward), [1, 0, 0], atol=1e-15)
    np.testing.assert_allclose(sampling.rotation(np.array([90, 0, 0])).apply(forward), [0, -1, 0], atol=1e-15)
    np.testing.assert_allclose(sampling.rotation(np.array([90, 90, 0])).apply(forward), [0, -1, 0], atol=1e-15)
    np.testing.assert_allclose(sampling.rotation(np.array([0, 90, 90])).apply([1, 0, 0]), [0, 1, 0], atol=1e-15)


TIMES, PATH = np.array([0.0, 0.1, 0.2]), np.array([[0.0, 0, 0], [0.1, 0.2, 0], [0.3, -0.1, 0.2]])


def with_keys(path, **fields):
    """A chain whose end goes as a file says."""
    return hung(pins=[{"vertices": [0], "posKeys": {"file": str(path), **fields}}])


@pytest.mark.slow
@pytest.mark.parametrize("name", ["gusts.csv", "bare.csv", "values.npz", "motion.npz", "body.pc2"])
def test_keys_from_files(tmp_path, name):
    path, said = tmp_path / name, {}
    body = np.stack([np.zeros((3, 3)), 5.0 + PATH], axis=1)  # the second point, somewhere else
    if name.endswith("csv"):
        rows = [",".join(map(repr, [float(t), *map(float, v)])) for t, v in zip(TIMES, PATH, strict=True)]
        path.write_text("\n".join(["time,x,y,z"] * (name == "gusts.csv") + rows) + "\n")
    elif name == "values.npz":
        np.savez(path, times=TIMES, values=PATH)
    elif name == "motion.npz":
        said = {"points": [1]}
        np.savez(path, times=TIMES, positions=body)
    else:
        said = {"points": [1], "fps": 10}
        for file, data in point_cache.encoded(str(path), Animation(from_scene(body, RIGHT), RIGHT)).items():
            with open(file, "wb") as stream:
                data(stream) if callable(data) else stream.write(data)
    inline = hung(pins=[{"vertices": [0], "posKeys": keys(TIMES, PATH)}])
    a, b = simulate(inline), simulate(with_keys(path, **said))
    np.testing.assert_allclose(b.positions, a.positions, atol=1e-6 if "pc2" in name else 1e-12)  # pc2: single floats


BAD_FILES = {
    "empty.csv": (b"", "no markers|empty|cannot|header|is no"),
    "words.csv": (b"time,x,y,z\n0,0,0,0\n1,a,b,c\n", "line 3 is not four numbers"),
    "late.csv": (b"0,0,0,0\n1,0,0,0\n1,1,1,1\n", "times must increase"),
    "gap.csv": (b"0,0,0,0\n1,nan,0,0\n", "has gaps"),
    "short.csv": (b"0,0,0,0\n1,1,1,1\n2,0,0\n", "line 3 has 3 columns"),
    "not.npz": (b"PK nothing", "is damaged"),
    "what.xyz": (b"1\nC 0 0 0\n", "no motion format has that suffix"),
    "no.csv": (None, "there is no such file"),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", BAD_FILES)
def test_files_that_are_no_keys_are_refused_with_their_place(tmp_path, name):
    content, said = BAD_FILES[name]
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(InvalidScene, match=said) as caught:
        simulate(with_keys(tmp_path / name))
    assert "objects[0].pins[0].posKeys.file: " in str(caught.value)


def test_points_that_do_not_fit(tmp_path):
    np.savez(tmp_path / "two.npz", times=TIMES, positions=np.zeros((3, 2, 3)))
    for points, said in (([], "2 points of the file for 1 vertices"), ([2], "there is no point 2; it has 2")):
        with pytest.raises(InvalidScene, match=said):
            simulate(with_keys(tmp_path / "two.npz", points=points))


# --- knots of controls beside keys that a scene has

STEPS = 0.02 * np.arange(201)
AT = knots.times(2.0, 0.02, 0.25)


def given(interpolation, end=2.5):
    """Keys between the knots, at some of them, and after the last."""
    at = np.array([0.0, 0.31, 0.5, 1.1, 1.4, end])
    return Keys(at, np.random.default_rng(5).standard_normal((6, 3)), interpolation)


def read(document):
    """The keys of a document."""
    values = [[each[axis] for axis in "xyz"] for each in document["values"]]
    return Keys(np.array(document["times"]), np.array(values), document["interpolation"])


@pytest.mark.parametrize("interpolation", ["linear", "smooth", "hold"])
def test_a_scene_keeps_its_own_values_to_the_end(interpolation):
    own = given(interpolation)
    both = read(knots.keyed(AT, own))
    np.testing.assert_allclose(interpolated(both, STEPS), interpolated(own, STEPS), rtol=0, atol=1e-13)  # rounding


def test_a_smooth_curve_that_ends_early_goes_on_nearly_as_it_did():
    """Between its end and the next knot a curve of two continuous derivatives cannot stand still at once."""
    own = given("smooth", 1.6)
    both = read(knots.keyed(AT, own))
    away = np.abs(interpolated(both, STEPS) - interpolated(own, STEPS)).max(axis=1)
    assert away[STEPS > 1.5].max() < 0.05 * np.ptp(own.values)
    assert away[STEPS < 0.31].max() < 1e-3


@pytest.mark.parametrize("interpolation", ["linear", "smooth", "hold"])
def test_a_change_is_that_of_its_knots_alone(interpolation):
    """The values of the keys change as a curve through the knots does, and stay after the last."""
    own, change = given(interpolation), np.random.default_rng(6).standard_normal((len(AT), 3))
    both = read(knots.keyed(AT, own))
    found = Keys(both.times, both.values + knots.shares(AT, both) @ change, interpolation)
    wanted = interpolated(own, STEPS) + interpolated(Keys(AT, change, interpolation), STEPS)
    early, near = STEPS < 1.7, 0.05 if interpolation == "smooth" else 1e-12  # a spline's last bend is felt before it
    np.testing.assert_allclose(interpolated(found, STEPS)[early], wanted[early], rtol=0, atol=near)
    np.testing.assert_allclose(interpolated(found, [2.5]), wanted[[125]], rtol=0, atol=1e-12)


def test_a_key_beside_a_knot_is_one_with_it():
    own = Keys(np.array([0.0, 0.1 * 3, 2.0]), np.arange(9.0).reshape(3, 3), "hold")  # 0.30000000000000004
    at = knots.times(2.0, 0.02, 0.1)
    both = read(knots.keyed(at, own))
    assert len(both.times) == len(at)
    assert (knots.shares(at, both).sum(axis=0) >= 1.0).all()


def test_no_more_knots_than_steps():
    assert len(knots.times(2.0, 0.02, 1e-300)) == 101
