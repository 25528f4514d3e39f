"""Values for Blender: what its springs make of them, and the script that sets them."""

import importlib.util
import os
import re
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from helpers.exports import built, content, of, two
from helpers.paths import ROOT
from helpers.scenes import cloth

from clothfit import load, simulate
from clothfit.export import blender as mapping
from clothfit.export.blender import FINER, SLOW, TIME_UNIT, bending_of, damping_of, painted, slopes, steps_of
from clothfit.export.tools import exported
from clothfit.export.topology import roles
from clothfit.formats.axes import from_scene


@pytest.fixture(scope="module")
def scene():
    """Two objects, the first with bending springs."""
    return two()


def blender(scene, number=0):
    """The time unit and the values of an object."""
    values = content(scene, "blender", "blender.json")
    return values["time_unit"], values["objects"][number]


def test_a_cloth_of_one_stiffness_comes_out_in_blender_as_it_is():
    plain = cloth(4, 3, springStiffness=[30.0] * 23, vertMass=[0.02] * 12, damping=0.2)
    unit, values = blender(of(plain))
    k = values["structural"]["stiffness"] / values["mean_length"]  # of a spring of Blender's, in its units
    gravity = 0.001 * 9.81
    # a weight on a spring hangs as low, in metres, as here …
    assert values["mass"] * gravity / k == pytest.approx(0.02 * 9.81 / 30.0, rel=1e-12)
    # … and swings as fast, in seconds, of which `time_scale` gives each frame its share
    for rate in (24.0, 60.0):
        per_second = rate / (rate * unit)
        assert per_second * (k / values["mass"]) ** 0.5 == pytest.approx((30.0 / 0.02) ** 0.5, rel=1e-12)
    # what damps takes the same part of a velocity per second
    assert 0.01 * values["air_damping"] / values["mass"] / unit == pytest.approx(0.2, rel=1e-12)
    assert values["spring_damping"] / k * unit == pytest.approx(0.1, rel=1e-12)
    assert values["structural"]["stiffness_max"] == values["structural"]["stiffness"]
    assert values["structural"]["largest_deviation"] < 1e-12


def test_weights_stay_within_0_and_1_and_are_the_nearest():
    (found,) = of(built()).cloths
    values = found.stiffness
    made = painted(len(found.mass), found.springs, values)
    assert 0 <= made.weights.min() <= made.weights.max() <= 1
    assert (made.low, made.high) == (values.min(), values.max())

    def cost(weights):
        return ((made.low + (made.high - made.low) * weights[found.springs].mean(axis=1) - values) ** 2).sum()

    rng = np.random.default_rng(4)
    nearby = [np.clip(made.weights + 0.01 * rng.normal(size=len(made.weights)), 0, 1) for _ in range(20)]
    assert all(cost(made.weights) < cost(other) for other in nearby)


class Mesh(SimpleNamespace):
    """A mesh of Blender's, as far as the script asks for it."""

    def __init__(self, count, modifiers=()):
        super().__init__(type="MESH", data=SimpleNamespace(vertices=[None] * count), groups={}, made=list(modifiers))
        self.modifiers, self.vertex_groups = self, self

    def __iter__(self):
        return iter(self.made)

    def get(self, name):
        return self.groups.get(name)

    def remove(self, group):
        del self.groups[group.name]

    def new(self, name, **kind):
        if kind:
            self.made.append(SimpleNamespace(**kind, settings=SimpleNamespace()))
            return self.made[-1]
        group = SimpleNamespace(name=name, weights={})
        group.add = lambda vertices, weight, mode: group.weights.update(dict.fromkeys(vertices, weight))
        self.groups[name] = group
        return group


def run_script(scene, active, monkeypatch, number=0):
    """Run the script in a Blender that is none."""
    context = SimpleNamespace(active_object=active, scene=SimpleNamespace(render=SimpleNamespace(fps=24, fps_base=1.0)))
    monkeypatch.setitem(sys.modules, "bpy", SimpleNamespace(context=context))
    text = exported(scene, "blender")["blender.py"].decode().replace("OBJECT = 0", f"OBJECT = {number}")
    exec(compile(text, "blender.py", "exec"), {"__name__": "__main__"})


@pytest.mark.parametrize("number", [0, 1])
def test_the_script_sets_what_the_file_says(scene, monkeypatch, number):
    unit, values = blender(scene, number)
    active = Mesh(values["vertices"])
    for _ in range(2):  # a second run replaces what the first has made
        run_script(scene, active, monkeypatch, number)
    (modifier,) = active.made
    set_ = modifier.settings
    assert (modifier.type, set_.mass, set_.bending_model) == ("CLOTH", values["mass"], "ANGULAR")
    assert set_.time_scale == pytest.approx(1 / (24 * unit), rel=1e-12)
    for kind in ("tension", "compression", "shear"):
        assert getattr(set_, f"{kind}_stiffness") == values["structural"]["stiffness"]
        assert getattr(set_, f"{kind}_stiffness_max") == values["structural"]["stiffness_max"]
    structural = active.groups[set_.vertex_group_structural_stiffness].weights
    assert structural == dict(enumerate(values["structural"]["weights"]))
    assert set(active.groups[set_.vertex_group_mass].weights) == set(values["pin"])
    assert hasattr(set_, "vertex_group_bending") == (values["bending"] is not None)
    bending = values["bending"] or {"stiffness": 0.0, "stiffness_max": 0.0}
    assert (set_.bending_stiffness, set_.bending_stiffness_max) == (bending["stiffness"], bending["stiffness_max"])
    assert set_.bending_damping == 0


def test_the_script_keeps_a_modifier_that_is_there_and_refuses_another_mesh(scene, monkeypatch):
    own = SimpleNamespace(type="CLOTH", settings=SimpleNamespace(use_pressure=True))
    active = Mesh(len(scene.cloths[0].mass), [SimpleNamespace(type="SUBSURF"), own])
    run_script(scene, active, monkeypatch)
    assert (len(active.made), own.settings.use_pressure) == (2, True)
    assert own.settings.mass == blender(scene)[1]["mass"]
    for active in (None, Mesh(5)):
        with pytest.raises(RuntimeError, match="select the mesh of object 0: it has 36 vertices"):
            run_script(scene, active, monkeypatch)


def bending(mass):
    """A cloth of some mass, its roles, ends and hinges of its bending springs, and 0.1 B ℓ/(3 τ²): what each of two
    vertices feels for an angle, as `make blender` finds it in Blender.
    """
    (found,) = of(built(vertMass=[mass] * 36)).cloths
    role = roles(found)
    ends, hinges = found.springs[role.bending], role.hinges[role.bending]
    length = np.linalg.norm(found.positions[hinges[:, 0]] - found.positions[hinges[:, 1]], axis=1)
    return found, role, ends, hinges, bending_of(found, role, 0.02) * 0.1 * length / TIME_UNIT**2 / 3


def test_bending_resists_as_the_spring_across_does_at_a_fold():
    found, role, ends, hinges, felt = bending(10.0)  # heavy, so that nothing is reduced
    torque = felt * (1 / slopes(found.positions, ends, hinges)[:, :2]).mean(axis=1)  # at the distance from the edge
    k, across = found.stiffness[role.bending], found.rest[role.bending]
    # The energy of a spring between two equal sides is k/2 L² (1 − cos θ/2)²; its derivative differs from the third
    # order by θ²/16, 2 % at half a radian.
    own = 0.5 * k * across**2 * (1 - np.cos(mapping.FOLD / 2)) * np.sin(mapping.FOLD / 2)
    np.testing.assert_allclose(torque * mapping.FOLD, own, rtol=0.02)
    assert len(ends) > 20


def by_angle(flat, axis):
    """The change of the angle of the hinge between points 2 and 3, of the faces with the points 0 and 1, by each of
    the four along an axis; the quotient is odd in the step, so its error is of the order of 1e-8.
    """

    def angle(points):
        a, b, c, d = points
        first, second = np.cross(d - c, a - c), np.cross(b - c, d - c)
        return np.arctan2(np.cross(first, second) @ (d - c) / np.linalg.norm(d - c), first @ second)

    steps = 1e-4 * np.eye(4)[:, :, None] * np.eye(3)[axis]
    return np.array([(angle(flat + step) - angle(flat - step)) / 2e-4 for step in steps])


def test_slopes_are_those_of_the_angle():
    rng = np.random.default_rng(5)
    for _ in range(5):
        flat = np.array([[0.3, 1, 0], [0.6, -1, 0], [0, 0, 0], [1, 0, 0]]) + 0.2 * rng.normal(size=(4, 3)) * [1, 1, 0]
        found = slopes(flat, np.array([[0, 1]]), np.array([[2, 3]]))[0]
        np.testing.assert_allclose(found, np.abs(by_angle(flat, 2)), rtol=1e-6)  # it moves out of its plane only


# The largest eigenvalue of the hinges' stiffness is that of the explicit step's frequency: 4 would not be stable.
@pytest.mark.parametrize("mass", [1e-8, 1e-5, 1.0])
def test_bending_is_stable_with_any_mass(mass):
    found, _, ends, hinges, felt = bending(mass)
    assert (felt > 0).all()
    matrix = np.zeros((36, 36))
    for four, value in zip(np.hstack([ends, hinges]), felt, strict=True):
        slope = by_angle(found.positions[four], 1)
        matrix[np.ix_(four, four)] += value * np.outer(np.sign(slope), slope)
    assert 0.02**2 * np.abs(np.linalg.eigvals(matrix)).max() / mass <= mapping.BENDING_LIMIT


@pytest.fixture(scope="module")
def names(scene):
    """The names of the script, without Blender."""
    found = {"__name__": "script"}
    text = exported(scene, "blender")["blender.py"].decode().replace("import bpy", "bpy = None  #")
    exec(compile(text, "blender.py", "exec"), found)
    return found


@pytest.mark.parametrize("rate", [24.0, 25.0, 30.0, 50.0, 60.0])
@pytest.mark.parametrize(("step", "fewest"), [(0.1, 1), (0.005, 0), (1e-9, 80)])
def test_the_quality_is_the_fewest_steps_without_one_too_many(names, rate, step, fewest):
    scale = 1 / (rate * TIME_UNIT)
    if rate == 50.0:  # Blender 4.2 takes 41 steps for a quality of 40, and 12 for one of 12: it adds float32 numbers
        assert [names["steps"](quality, scale) for quality in (1, 5, 12, 40)] == [1, 5, 12, 41]
    names["DATA"]["step"] = step
    quality = names["quality_of"](rate, scale)
    assert fewest <= quality <= 80
    if quality < 80:
        assert quality * rate * step >= 1 - 1e-6
        assert names["steps"](quality, scale) == quality
    between = range(max(1, int(np.ceil(1 / (rate * step) - 1e-6))), quality)
    assert all(names["steps"](each, scale) > each for each in between)


# Blender's step is the implicit one, so a scene with another gets shorter ones.
@pytest.mark.parametrize(("method", "step"), [("implicit", 0.01), ("bdf2", 0.01 / FINER), ("symplectic", 0.01 / FINER)])
def test_implicit_scenes_keep_their_step_and_others_get_a_finer_one(scene, method, step):
    assert content(scene.with_step(0.01, method=method), "blender", "blender.json")["step"] == step
    stiff = of(cloth(4, 3, springStiffness=[1e12] * 23, vertMass=[0.02] * 12))  # of which there are no more parts
    assert steps_of(stiff.with_step(0.01, method=method)) == (step / mapping.MOST_PARTS, mapping.MOST_PARTS)


@pytest.mark.parametrize("stiffness", [1.0, 3e6, 1e7])
def test_a_stiff_cloth_gets_the_fewest_parts_of_a_step_that_the_solver_bears(stiffness):
    made = cloth(4, 3, springStiffness=[stiffness] * 23, vertMass=[0.02] * 12, damping=0.0)
    scene = of(made).with_step(0.01, method="implicit")
    step, parts = steps_of(scene)

    def hard(each):
        return 12**0.5 * each**2 * stiffness / 0.02

    assert step * parts == pytest.approx(0.01, rel=1e-15)
    assert hard(step) <= mapping.STIFFNESS_LIMIT
    assert parts == 1 or hard(0.01 / (parts - 1)) > mapping.STIFFNESS_LIMIT
    # implicit steps of h damp a long wave as springs of h k do: what shorter ones lose is added
    k = np.full(23, stiffness)
    assert damping_of(scene.cloths[0], k, step, parts) == pytest.approx((0.01 - step) * stiffness, rel=1e-12)


# A fall takes √(L/g); springs damped for as long as half of that slow it, and only they get more than h k.
@pytest.mark.parametrize(("share", "times"), [(0.0, 0.75), (SLOW / 2, 1.75), (SLOW, 4.0), (9 * SLOW, 4.0)])
def test_slow_cloths_get_more_damping_with_shorter_steps(share, times):
    fall = (3.0 / mapping.GRAVITY) ** 0.5  # of a cloth of 3 m
    own = of(cloth(4, 3, springStiffness=[1e9] * 23, vertMass=[1e-3] * 12, damping=2 * share * fall)).cloths[0]
    assert np.ptp(own.positions, axis=0).max() == 3.0
    h, k = 0.02, np.full(23, 1e9)
    assert damping_of(own, k, h / 4, 4) == pytest.approx(times * h * 1e9, rel=1e-12)


def test_damping_of_light_cloths_is_what_the_solver_bears():
    small = of(cloth(4, 3, springStiffness=[3e3] * 23, vertMass=[0.02] * 12, damping=1.0)).cloths[0]
    large = of(cloth(40, 30, vertMass=[0.02] * 1200, damping=1.0)).cloths[0]
    k, h = np.full(9, 1e5), 0.01
    assert damping_of(small, k, h) == 2 * h * 1e5  # (α/2) k is 50 h k
    assert damping_of(large, k, h) == pytest.approx(h * 1e5, rel=1e-15)
    assert damping_of(large, k / 50, h) == pytest.approx(2 * h * 2e3, rel=1e-15)
    assert h * 1e5 > mapping.DAMPING_SPREAD * 0.02 / 1200 / h > 2 * h * 2e3


def test_the_page_tells_how_near_weights_come():
    values = blender(load(ROOT / "examples" / "corners.json"))[1]["structural"]
    page = " ".join((ROOT / "docs" / "export.md").read_text("utf-8").split())
    figures = re.search(r"(\d+) and (\d+) % on `examples/corners.json`", page).groups()
    assert [round(100 * values[name]) for name in ("median_deviation", "largest_deviation")] == list(map(int, figures))


# The bounds are those of the benchmark's docs: other models of cloth, after a fifth of a second and half of one.
@pytest.mark.slow  # starts a process
@pytest.mark.parametrize("name", ["light", "corners"])
def test_a_cloth_falls_in_blender_as_here(tmp_path, name):
    """Where a Python with Blender is at hand: CLOTHFIT_BPY names such a one, in an environment of its own (`pip install
    bpy==4.2.23 'numpy<2'` for Python 3.11).
    """
    spec = importlib.util.spec_from_file_location("blender_benchmark", ROOT / "benchmarks" / "blender.py")
    benchmark = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(benchmark)
    python = os.environ.get("CLOTHFIT_BPY", sys.executable)
    if not benchmark.has_blender(python):
        pytest.skip("no Blender as a Python module; name a Python that has one by CLOTHFIT_BPY")
    scene = benchmark.CLOTHS[name]()
    motion = simulate(scene)
    jobs = benchmark.jobs_of(scene, motion, tmp_path, name)
    jobs[0]["frames"] = 26
    cloth, file = benchmark.played(python, jobs, tmp_path)
    truth = from_scene(motion.positions, benchmark.BLENDERS)
    assert np.isfinite(cloth).all()
    for frame in (10, 25):
        assert benchmark.rms(cloth[frame] - truth[frame]) < 0.15 * benchmark.rms(truth[frame] - truth[0])
    assert np.linalg.norm(file - truth, axis=2).max() < 1e-5 + 4e-7  # of float32 numbers up to 4 m
