"""Values for Blender: what its springs make of them, and the script that sets them."""

import re
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from helpers.exports import built, content, of, two
from helpers.paths import ROOT
from helpers.scenes import cloth

from clothfit import load
from clothfit.export.blender import painted
from clothfit.export.tools import exported


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


def test_weights_of_vertices_give_back_values_that_weights_can_hold():
    (found,) = of(cloth(5, 4)).cloths
    weights = np.random.default_rng(3).uniform(size=20)
    weights[[0, 1]], weights[[18, 19]] = 0.0, 1.0  # so that the smallest and the largest value are those of 0 and 1
    made = painted(20, found.springs, 10.0 + 30.0 * weights[found.springs].mean(axis=1))
    # the matrix of the means is well conditioned on a triangulated grid; the solver stops at 1e-10 of the cost
    assert made.weights == pytest.approx(weights, abs=1e-4)
    assert made.largest < 1e-4


def test_weights_stay_within_0_and_1_and_are_the_nearest():
    (found,) = of(built()).cloths
    values = found.stiffness
    made = painted(len(found.mass), found.springs, values)
    assert made.weights.min() >= 0
    assert made.weights.max() <= 1
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


def test_the_script_keeps_a_modifier_that_is_there(scene, monkeypatch):
    own = SimpleNamespace(type="CLOTH", settings=SimpleNamespace(quality=7))
    active = Mesh(len(scene.cloths[0].mass), [SimpleNamespace(type="SUBSURF"), own])
    run_script(scene, active, monkeypatch)
    assert len(active.made) == 2
    assert own.settings.quality == 7
    assert own.settings.mass == blender(scene)[1]["mass"]


@pytest.mark.parametrize("active", [None, Mesh(5)])
def test_the_script_refuses_another_mesh(scene, monkeypatch, active):
    with pytest.raises(RuntimeError, match="select the mesh of object 0: it has 36 vertices"):
        run_script(scene, active, monkeypatch)


def test_the_page_tells_how_near_weights_come():
    values = blender(load(ROOT / "examples" / "corners.json"))[1]["structural"]
    page = " ".join((ROOT / "docs" / "export.md").read_text("utf-8").split())
    figures = re.search(r"(\d+) and (\d+) % on `examples/corners.json`", page).groups()
    assert [round(100 * values[name]) for name in ("median_deviation", "largest_deviation")] == list(map(int, figures))
