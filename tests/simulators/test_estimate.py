"""Fits of a tool's values: XPBD finds what XPBD moved with; the command writes them."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import clothfit
from clothfit.base.errors import InvalidInput
from clothfit.cli.program import run
from clothfit.export.blender import one, steps_of
from clothfit.export.topology import roles
from clothfit.meshes.mesh import plane
from clothfit.motion.motion import Motion
from clothfit.objective.target import target
from clothfit.simulators import blender_values, many_values, sweeps, xpbd, xpbd_values
from clothfit.simulators.blender import left_out, values_of, with_values
from clothfit.simulators.blender_process import program
from clothfit.simulators.estimate import Options, each, estimate
from clothfit.simulators.many_values import ManyFit
from clothfit.simulators.values import Fitted, Tool, Value

pytestmark = pytest.mark.slow  # compiles

FRAMES = 15


@pytest.fixture(scope="module")
def scene():
    """A sheet of 5 × 5 vertices that hangs at two corners."""
    mesh = plane(3, 1.0)
    held = np.zeros(len(mesh.positions), bool)
    held[[0, 4]] = True
    return clothfit.new_scene(
        mesh, held, density=0.2, stiffness=20.0, damping=0.1, drag=5.0, frames=FRAMES, integrator="implicit"
    )


def test_xpbd_finds_the_values_that_a_cloth_of_xpbd_moved_with(scene):
    settings = xpbd.Settings(2, 3)
    tool = xpbd_values.tool_of(scene, 0, settings, FRAMES)
    truth = np.array([value.start for value in tool.values]) * [1.6, 0.7, 1.3, 2.0, 0.5, 0.8, 1.2, 0.9, 1.5, 0.6]
    motion = Motion(tool.motion(truth), scene.delta * np.arange(FRAMES), scene.vertex_counts, None, "xpbd")
    (found,) = estimate(scene, motion, Options("xpbd", settings))
    assert found.mapped_rmse > 1e-3 * found.travel
    # what is left is the weak pull to the mapping, a hundred-thousandth of the way for a factor e
    assert found.rmse < 1e-5 * found.travel
    assert found.found[:2] == pytest.approx(truth[:2], rel=1e-2)


def test_the_columns_are_the_change_by_the_logarithms(scene):
    tool = xpbd_values.tool_of(scene, 0, xpbd.Settings(2, 2), FRAMES)
    values = np.array([value.start for value in tool.values]) * 1.1
    columns, e = tool.columns(values), 1e-5
    for k in range(len(values)):
        step = np.exp(e * (np.arange(len(values)) == k))
        wanted = (tool.motion(values * step) - tool.motion(values / step)) / (2 * e)
        assert np.abs(columns[k] - wanted).max() < 1e-7 * max(np.abs(wanted).max(), 1e-3)


def test_a_fit_is_never_worse_than_the_mapping(scene):
    motion = clothfit.simulate(scene)
    for settings in (xpbd.Settings(1, 2), xpbd.Settings(3, 1, "angle")):
        (found,) = estimate(scene, motion, Options("xpbd", settings))
        assert found.rmse <= found.mapped_rmse
        model = xpbd.model_of(scene, 0, settings, FRAMES)
        mapped, _ = sweeps.simulate(model, FRAMES)
        gaps = np.linalg.norm(mapped - motion.positions, axis=2)
        assert found.mapped_rmse == pytest.approx(np.sqrt((gaps**2).mean()), rel=1e-9)


def test_the_command_writes_the_values(scene, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    clothfit.save(scene, "sheet.json")
    assert run(["estimate", "sheet.json", "--simulator", "xpbd", "--iterations", "3", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    (one,) = told["objects"]
    assert one["rmse"] <= one["mapped_rmse"]
    kept = json.loads((tmp_path / "sheet-xpbd" / "xpbd-values.json").read_text())
    assert kept["objects"] == [one]
    document = json.loads((tmp_path / "sheet-xpbd" / "obi.json").read_text())
    obi, solver = document["objects"][0], document["objects"][0]["solver"]
    assert solver["substeps"] == 1
    factors = {value["name"]: value["fitted"] for value in one["values"]}
    (own,) = scene.cloths
    for kind, name in (("distance", "distance"), ("bending", "bending")):
        assert solver[kind] == {"iterations": 3, "SORFactor": factors[f"{name} relaxation"]}
    bent = obi["bend"]["spring"]
    wanted = factors["bending compliance"] / own.stiffness[bent]
    assert obi["bend"]["compliance"] == pytest.approx(wanted, rel=1e-12)


def test_xpbd_finds_the_values_of_each_constraint(scene):
    settings, rng = xpbd.Settings(1, 4), np.random.default_rng(2)
    few = xpbd_values.tool_of(scene, 0, settings, FRAMES)
    begin = np.array([value.start for value in few.values])
    tool, _ = xpbd_values.each_of(scene, 0, settings, FRAMES, begin)
    truth = np.array([value.start for value in tool.values])
    truth *= np.exp(0.1 * rng.normal(size=len(truth)))
    motion = Motion(tool.motion(truth), scene.delta * np.arange(FRAMES), scene.vertex_counts, None, "xpbd")
    (found,) = estimate(scene, motion, Options("xpbd", settings, most=6, model="L"))
    # the few values cannot make it; with each, what is left falls with every step
    assert found.rmse < 0.1 * found.few.rmse < 0.1 * found.few.mapped_rmse
    again = np.linalg.norm(found.tool.motion(found.found) - motion.positions, axis=2)
    assert found.rmse == pytest.approx(np.sqrt((again**2).mean()), rel=1e-6)


def test_tangent_and_adjoint_of_each_value_are_those_of_the_motion(scene):
    settings, rng, e = xpbd.Settings(1, 3), np.random.default_rng(4), 1e-5
    begin = np.array([value.start for value in xpbd_values.tool_of(scene, 0, settings, FRAMES).values])
    tool, _ = xpbd_values.each_of(scene, 0, settings, FRAMES, begin)
    values = np.array([value.start for value in tool.values])
    change = rng.normal(size=len(values))
    found = tool.push(values, change)
    wanted = (tool.motion(values * np.exp(e * change)) - tool.motion(values * np.exp(-e * change))) / (2 * e)
    assert np.abs(found - wanted).max() < 1e-7 * np.abs(wanted).max()  # of order e²
    weights = rng.normal(size=found.shape)
    assert tool.pull(values, weights) @ change == pytest.approx((weights * found).sum(), rel=1e-9)


def test_the_derivative_between_frames_is_the_adjoint_of_the_samples(scene):
    """A target whose clock is not that of the steps."""
    motion = clothfit.simulate(scene)
    slower = Motion(motion.positions[::2], 0.83 * motion.times[::2], scene.vertex_counts, None, "slow")
    goal = target(slower, 0, scene.delta, FRAMES - 1)
    assert (goal.fraction > 0.01).any()
    few = xpbd_values.tool_of(scene, 0, xpbd.Settings(1, 2), FRAMES)
    tool, _ = xpbd_values.each_of(scene, 0, xpbd.Settings(1, 2), FRAMES, np.array([v.start for v in few.values]))
    fit, rng = ManyFit(tool, goal, None), np.random.default_rng(5)
    own = fit.operator(fit.start)
    d, r = (rng.normal(size=size) for size in own.shape[::-1])
    assert own.matvec(d) @ r == pytest.approx(own.rmatvec(r) @ d, rel=1e-9)
    # and what is added up frame by frame is the same
    rows, columns = zip(*fit.frames(fit.start, 0.0, along=True), strict=True)
    assert fit.scale * np.concatenate(columns) @ d == pytest.approx(own.matvec(d)[: -len(d)], rel=1e-9, abs=1e-12)
    assert fit.scale * np.concatenate(rows) == pytest.approx(fit.residuals(fit.start)[: -len(d)], rel=1e-12)


def test_the_changes_of_a_nudged_motion_are_those_of_its_distances(scene):
    goal = target(clothfit.simulate(scene), 0, scene.delta, FRAMES - 1)
    few = xpbd_values.tool_of(scene, 0, xpbd.Settings(1, 2), FRAMES)
    tool, _ = xpbd_values.each_of(scene, 0, xpbd.Settings(1, 2), FRAMES, np.array([v.start for v in few.values]))
    fit, e = ManyFit(tool, goal, None), 1e-5
    d = np.random.default_rng(6).normal(size=len(fit.start))
    found = np.concatenate([columns @ d for _, columns in fit.frames(fit.start, 0.3, along=True)])
    up, down = (fit.pulled(fit.start + s * e * d, 0.3)[: len(found)] for s in (1, -1))
    assert found * fit.scale == pytest.approx((up - down) / (2 * e), rel=1e-6, abs=1e-9)  # of order e²
    # an error lasts for a few steps only: the nudged motion is nearer
    assert np.linalg.norm(fit.pulled(fit.start, 0.9)) < 0.5 * np.linalg.norm(fit.pulled(fit.start, 0.0))


def test_many_more_values_are_fitted_by_products(scene, monkeypatch):
    monkeypatch.setattr(many_values, "DENSE", 10)
    (found,) = estimate(scene, None, Options("xpbd", xpbd.Settings(1, 3), most=3, model="L"))
    assert found.rmse < 0.9 * found.few.rmse


@pytest.mark.parametrize("bending", xpbd.BENDING)
def test_rest_lengths_are_those_of_distances(scene, bending):
    settings = xpbd.Settings(1, 2, bending)
    few = xpbd_values.tool_of(scene, 0, settings, FRAMES)
    tool, begin = xpbd_values.each_of(scene, 0, settings, FRAMES, np.array([v.start for v in few.values]))
    lengths = np.array([value.mapped for value in tool.values if value.name == "rest length"])
    (own,) = scene.cloths
    distances = np.ones(len(own.rest), bool) if bending == "distance" else ~roles(own).bending
    assert (lengths == own.rest[distances]).all()
    assert len(begin) == len(tool.values)


def test_the_command_writes_the_values_of_each(scene, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(many_values, "SEARCHED", 0)
    clothfit.save(scene, "sheet.json")
    options = ["--simulator", "xpbd", "--iterations", "2", "--model", "L", "--json"]
    assert run(["estimate", "sheet.json", *options]) == 0
    (one,) = json.loads(capsys.readouterr().out)["objects"]
    assert one["rmse"] <= one["few_rmse"] <= one["mapped_rmse"]
    (own,) = scene.cloths
    assert [len(one["each"][name]["fitted"]) for name in ("compliance", "damping", "mass")] == [
        len(own.springs), len(own.springs), int((~own.fixed).sum())
    ]  # fmt: skip
    obi = json.loads((tmp_path / "sheet-xpbd" / "obi.json").read_text())["objects"][0]
    compliance = np.array(one["each"]["compliance"]["fitted"])
    assert obi["distance"]["compliance"] == pytest.approx(compliance[obi["distance"]["spring"]], rel=1e-12)
    masses = np.array(obi["particles"]["mass"])[~own.fixed]
    rests = np.array(one["each"]["rest length"]["fitted"])
    assert obi["distance"]["restLength"] == pytest.approx(rests[obi["distance"]["spring"]], rel=1e-12)
    assert masses == pytest.approx(np.array(one["each"]["mass"]["fitted"]), rel=1e-12)


@pytest.mark.parametrize(
    ("options", "code", "words"),
    [
        (["--simulator", "vellum"], 3, "use xpbd or blender"),
        (["--simulator", "xpbd", "--iterations", "0"], 3, "iterations must be within"),
        (["--simulator", "xpbd", "--substeps", "auto"], 3, "must be a whole number"),
        (["--simulator", "xpbd", "--model", "M"], 3, "fitted by G and L"),
        (["--iterations", "3"], 2, "are for --simulator xpbd"),
        (["--simulator", "xpbd", "--in-place"], 3, "need a folder"),
        (["--simulator", "blender", "--blender", "/no/such/python"], 3, "no such program"),
    ],
)
def test_what_cannot_be_is_refused(scene, tmp_path, capsys, options, code, words):
    path = tmp_path / "sheet.json"
    clothfit.save(scene, path)
    assert run(["estimate", str(path), *options]) == code
    assert words in capsys.readouterr().err


def test_without_blender_the_message_says_how_to_name_it(monkeypatch):
    monkeypatch.delenv("CLOTHFIT_BPY", raising=False)
    monkeypatch.setenv("PATH", "")
    with pytest.raises(InvalidInput, match="CLOTHFIT_BPY"):
        program(None)


def test_blenders_values_are_factors_on_the_mapped_ranges():
    base = {
        "structural": {"stiffness": 2.0, "stiffness_max": 6000.0, "weights": [0.5]}, "spring_damping": 0.0,
        "bending": {"stiffness": 0.0, "stiffness_max": 0.3, "weights": [1.0]}, "air_damping": 0.1, "mass": 0.01,
    }  # fmt: skip
    values = values_of(base)
    names = [value.name for value in values]
    assert all(value.start > 0 for value in values)
    numbers = dict.fromkeys(names, 2.0) | {"mass": 0.02, "compression": 0.5}
    made = with_values(base, names, np.array([numbers[name] for name in names]))
    assert made["tension"] == {"stiffness": 4.0, "stiffness_max": 10_000.0}  # Blender's limit
    assert made["compression"] == {"stiffness": 1.0, "stiffness_max": 3000.0}
    assert made["bending"]["stiffness_max"] == 0.6
    assert made["bending"]["weights"] == [1.0]
    assert made["mass"] == 0.02
    assert base["bending"]["stiffness_max"] == 0.3


def test_values_of_vertices_are_ranges_and_weights():
    group = {"stiffness": 2.0, "stiffness_max": 6.0, "weights": [0.0, 0.5, 1.0]}
    base = {"structural": group, "bending": None, "tension": {"stiffness": 4.0, "stiffness_max": 12.0}}
    stiffness, length = np.array([1.0, 3.0, 2.0]), np.array([0.9, 1.0, 1.2])
    assert blender_values.at_vertices(group).tolist() == [2.0, 4.0, 6.0]
    made = blender_values.with_each(base, {"stiffness": stiffness, "rest length": length})
    assert blender_values.at_vertices(made["structural"]) == pytest.approx(stiffness)
    assert made["tension"] == {"stiffness": 2.0, "stiffness_max": 6.0}  # still twice the others
    shrink = made["shrink"]
    spread = shrink["most"] - shrink["least"]
    assert 1 - shrink["least"] - spread * np.array(shrink["weights"]) == pytest.approx(length)


def test_the_model_near_blenders_changes_with_the_values_of_vertices(scene):
    (own,) = scene.cloths
    begin = one(0, own, *steps_of(scene))
    few = xpbd_values.tool_of(scene, 0, xpbd.Settings(1, 1), 6)
    tool = blender_values.each_of(scene, 0, few, begin, 6, scene.delta, None)
    values, e = np.array([value.start for value in tool.values]), 1e-5
    assert {value.name for value in tool.values} == {"stiffness", "bending", "rest length"}
    d = np.random.default_rng(7).normal(size=len(values))

    def last(numbers, along=False):
        state = tool.sweep(numbers, along)
        for t in range(5):
            state.advance(t)
        return state

    found = last(values, True).dx @ d
    up, down = (last(values * np.exp(s * e * d)).x for s in (1, -1))
    assert np.abs((up - down) / (2 * e) - found).max() < 1e-7 * np.abs(found).max()  # of order e²


def test_what_blenders_cloth_has_not_is_said(scene):
    assert left_out(scene) == ["the drag of the air"]
    mesh = plane(1, 1.0)
    windy = clothfit.new_scene(mesh, drag=0.1, wind=(1, 0, 0), spheres=[(0, -1, 0, 0.5)])
    assert left_out(windy) == ["the wind", "the drag of the air", "the spheres"]
    assert left_out(clothfit.new_scene(mesh, drag=0.0, wind=(1, 0, 0))) == []


@pytest.mark.parametrize(("ends", "counts"), [((0.3, 0.2), 1.0), ((0.2, 0.3), 2.0)])
def test_fits_of_each_vertex_in_blender_start_from_the_few_and_the_mapped_values(monkeypatch, ends, counts):
    """The better end counts, with the few values that it started from; the runs of both are counted."""
    few = Tool("blender", (Value("mass", "kg", 1.0, 1.0),), lambda numbers: None)
    found, still = np.array([2.0]), np.zeros((2, 1, 3))
    end = {2.0: ends[0], 1.0: ends[1]}  # by the value that a descent starts from

    def tool_of(scene, index, frames, running, begin):
        return replace(few, values=(Value("rest length", "", float(begin[0]), float(begin[0])),))

    class Descent:
        def __init__(self, tool, goal, told):
            self.tool = tool

        def run(self, most):
            start = self.tool.values[0].start
            return Fitted(self.tool, np.ones(1), 0.9, end[start], 1.0, 10, still)

    monkeypatch.setattr("clothfit.simulators.blender.tool_of", tool_of)
    monkeypatch.setattr("clothfit.simulators.estimate.ManyFit", Descent)
    fitted = Fitted(few, found, 0.9, 0.5, 1.0, 7, still)
    made = each(None, 0, SimpleNamespace(last_step=1), Options("blender", model="L"), fitted, lambda *_: None, None)
    assert (made.rmse, made.simulations) == (0.2, 27)
    assert (made.few.found.tolist(), made.few.rmse) == ([counts], 0.5)
