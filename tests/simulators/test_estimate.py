"""Fits of a tool's values: XPBD finds what XPBD moved with; the command writes them."""

import json

import numpy as np
import pytest

from clothfit import Motion, new_scene, save, simulate
from clothfit.cli.program import run
from clothfit.export.topology import roles
from clothfit.meshes.mesh import plane
from clothfit.objective.target import target
from clothfit.simulators import directions, values, xpbd
from clothfit.simulators.blender import left_out, values_of, with_values
from clothfit.simulators.estimate import Options, estimate
from clothfit.simulators.values import ElementFit

pytestmark = pytest.mark.slow  # compiles

FRAMES = 15


@pytest.fixture(scope="module")
def scene():
    """A sheet of 4 × 4 vertices that hangs at two corners."""
    mesh = plane(2, 1.0)
    held = np.zeros(len(mesh.positions), bool)
    held[[0, 3]] = True
    return new_scene(
        mesh, held, density=0.2, stiffness=20.0, damping=0.1, drag=5.0, frames=FRAMES, integrator="implicit"
    )


@pytest.fixture
def folder(scene, tmp_path, monkeypatch):
    """A folder to work in, with the scene."""
    monkeypatch.chdir(tmp_path)
    save(scene, "sheet.json")
    return tmp_path


def moved(scene, tool, factors):
    """The motion of a tool with its values at the start times some factors; and these values."""
    truth = np.array([value.start for value in tool.values]) * factors
    return Motion(tool.motion(truth), scene.delta * np.arange(FRAMES), scene.vertex_counts, None, "xpbd"), truth


def test_xpbd_finds_the_values_that_a_cloth_of_xpbd_moved_with(scene):
    settings = xpbd.Settings(2, 3)
    tool = xpbd.tool_of(scene, 0, settings, FRAMES)
    motion, truth = moved(scene, tool, [1.6, 0.7, 1.3, 2.0, 0.5, 0.8, 1.2, 0.9, 1.5, 0.6])
    (found,) = estimate(scene, motion, Options("xpbd", settings))
    assert found.mapped_rmse > 1e-3 * found.travel
    # what is left is the weak pull to the mapping, a hundred-thousandth of the way for a factor e
    assert found.rmse < 1e-5 * found.travel
    assert found.found[:2] == pytest.approx(truth[:2], rel=1e-2)


def test_the_columns_are_the_change_by_the_logarithms(scene):
    tool = xpbd.tool_of(scene, 0, xpbd.Settings(2, 2), FRAMES)
    values = np.array([value.start for value in tool.values]) * 1.1
    columns, e = tool.columns(values), 1e-5
    for k in range(len(values)):
        step = np.exp(e * (np.arange(len(values)) == k))
        wanted = (tool.motion(values * step) - tool.motion(values / step)) / (2 * e)
        assert np.abs(columns[k] - wanted).max() < 1e-7 * max(np.abs(wanted).max(), 1e-3)


def test_a_fit_is_never_worse_than_the_mapping(scene):
    motion = simulate(scene)
    for settings in (xpbd.Settings(1, 2), xpbd.Settings(3, 1, "angle")):
        (found,) = estimate(scene, motion, Options("xpbd", settings))
        assert found.rmse <= found.mapped_rmse
        model = xpbd.model_of(scene, 0, settings, FRAMES)
        mapped, _ = directions.simulate(model, FRAMES)
        gaps = np.linalg.norm(mapped - motion.positions, axis=2)
        assert found.mapped_rmse == pytest.approx(np.sqrt((gaps**2).mean()), rel=1e-9)


def command(folder, capsys, *options):
    """What a fit of the scene in XPBD says and writes of its object: the summary, and what Obi is given."""
    assert run(["estimate", "sheet.json", "--simulator", "xpbd", *options, "--json"]) == 0
    (one,) = json.loads(capsys.readouterr().out)["objects"]
    kept, obi = (json.loads((folder / "sheet-xpbd" / name).read_text()) for name in ("xpbd-values.json", "obi.json"))
    assert kept["objects"] == [one]
    return one, obi["objects"][0]


def test_the_command_writes_the_values(scene, folder, capsys):
    one, obi = command(folder, capsys, "--iterations", "3")
    assert one["rmse"] <= one["mapped_rmse"]
    assert obi["solver"]["substeps"] == 1
    factors = {value["name"]: value["fitted"] for value in one["values"]}
    (own,) = scene.cloths
    for kind in ("distance", "bending"):
        assert obi["solver"][kind] == {"iterations": 3, "SORFactor": factors[f"{kind} relaxation"]}
    bent = obi["bend"]["spring"]
    wanted = factors["bending compliance"] / own.stiffness[bent]
    assert obi["bend"]["compliance"] == pytest.approx(wanted, rel=1e-12)


def test_xpbd_finds_the_values_of_each_constraint(scene):
    settings, rng = xpbd.Settings(1, 4), np.random.default_rng(2)
    tool = xpbd.each_of(scene, 0, settings, FRAMES).tool(FRAMES)
    motion, _ = moved(scene, tool, np.exp(0.1 * rng.normal(size=len(tool.values))))
    (found,) = estimate(scene, motion, Options("xpbd", settings, most=6, model="L"))
    # the few values cannot make it; with each, what is left falls with every step
    assert found.rmse < 0.1 * found.few.rmse < 0.1 * found.few.mapped_rmse
    again = np.linalg.norm(found.tool.motion(found.found) - motion.positions, axis=2)
    assert found.rmse == pytest.approx(np.sqrt((again**2).mean()), rel=1e-6)


def along(scene, motion, pull):
    """A fit of each value from the mapped ones to a motion that is pulled so far, the distances of its frames, and
    their changes along a direction: those that it has, and central differences, whose error is of order 1e-10.
    """
    tool = xpbd.each_of(scene, 0, xpbd.Settings(1, 2), FRAMES).tool(FRAMES)
    goal = target(motion, 0, scene.delta, FRAMES - 1)
    fit, e = ElementFit(tool, goal, None, np.array([value.start for value in tool.values])), 1e-5
    d = np.random.default_rng(5).normal(size=len(fit.start))
    rows, columns = (fit.scale * np.concatenate(each) for each in zip(*fit.frames(fit.start, pull, along=True),
                                                                      strict=True))  # fmt: skip
    up, down = (fit.nudged_residuals(fit.start + s * e * d, pull)[: -len(d)] for s in (1, -1))
    assert columns @ d == pytest.approx((up - down) / (2 * e), rel=1e-6, abs=1e-9)
    return fit, rows


def test_the_derivative_between_frames_is_that_of_the_samples(scene):
    """A target whose clock is not that of the steps."""
    motion = simulate(scene)
    slower = Motion(motion.positions[::2], 0.83 * motion.times[::2], scene.vertex_counts, None, "slow")
    fit, rows = along(scene, slower, 0.0)
    assert (fit.goal.fraction > 0.01).any()
    assert rows == pytest.approx(fit.residuals(fit.start)[: len(rows)], rel=1e-12)


def test_the_changes_of_a_nudged_motion_are_those_of_its_distances(scene):
    fit, _ = along(scene, simulate(scene), 0.3)
    # an error lasts for a few steps only: the nudged motion is nearer
    nudged, free = (np.linalg.norm(fit.nudged_residuals(fit.start, each)) for each in (0.9, 0.0))
    assert nudged < 0.5 * free


def test_more_values_than_are_fitted_one_by_one_are_refused_before_any_fit(folder, monkeypatch, capsys):
    monkeypatch.setattr("clothfit.simulators.estimate.MOST_ELEMENTS", 150)
    monkeypatch.delattr("clothfit.simulators.estimate.Fit")
    assert run(["estimate", "sheet.json", "--simulator", "xpbd", "--model", "L"]) == 3
    assert "at most 150 values in xpbd, and this cloth has 193; use --model G" in capsys.readouterr().err


def test_rest_lengths_are_those_of_distances(scene):
    (own,) = scene.cloths
    for bending, distances in (("distance", slice(None)), ("angle", ~roles(own).bending)):
        each = xpbd.each_of(scene, 0, xpbd.Settings(1, 2, bending), FRAMES)
        lengths = [value.mapped for value in each.values if value.name == "rest length"]
        assert lengths == own.rest[distances].tolist()


def test_the_command_writes_the_values_of_each(scene, folder, monkeypatch, capsys):
    monkeypatch.setattr(values, "NUDGES", ())
    monkeypatch.setattr(values, "LEAVING", ())
    one, obi = command(folder, capsys, "--iterations", "2", "--model", "L")
    assert one["rmse"] <= one["few_rmse"] <= one["mapped_rmse"]
    (own,) = scene.cloths
    assert [len(one["each"][name]["fitted"]) for name in ("compliance", "damping", "mass")] == [
        len(own.springs), len(own.springs), int((~own.fixed).sum())
    ]  # fmt: skip
    fitted = {name: np.array(each["fitted"]) for name, each in one["each"].items()}
    for name, key in (("compliance", "compliance"), ("rest length", "restLength")):
        assert obi["distance"][key] == pytest.approx(fitted[name][obi["distance"]["spring"]], rel=1e-12)
    assert np.array(obi["particles"]["mass"])[~own.fixed] == pytest.approx(fitted["mass"], rel=1e-12)


@pytest.mark.parametrize(
    ("options", "code", "words"),
    [
        (["--simulator", "vellum"], 3, "use xpbd or blender"),
        (["--simulator", "xpbd", "--iterations", "0"], 3, "iterations must be within"),
        (["--simulator", "xpbd", "--substeps", "auto"], 3, "must be a whole number"),
        (["--simulator", "xpbd", "--model", "M"], 3, "fitted by G and L"),
        (["--simulator", "blender", "--model", "L"], 3, "fitted by G"),
        (["--iterations", "3"], 2, "are for --simulator xpbd"),
        (["--simulator", "xpbd", "--in-place"], 3, "need a folder"),
        (["--simulator", "blender", "--blender", "/no/such/python"], 3, "no such program"),
        (["--simulator", "blender"], 3, "CLOTHFIT_BPY"),
    ],
)
def test_what_cannot_be_is_refused(folder, monkeypatch, capsys, options, code, words):
    monkeypatch.delenv("CLOTHFIT_BPY", raising=False)
    monkeypatch.setenv("PATH", "")
    assert run(["estimate", "sheet.json", *options]) == code
    assert words in capsys.readouterr().err


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


def test_what_blenders_cloth_has_not_is_said(scene):
    assert left_out(scene) == ["the drag of the air"]
    mesh = plane(1, 1.0)
    windy = new_scene(mesh, drag=0.1, wind=(1, 0, 0), spheres=[(0, -1, 0, 0.5)])
    assert left_out(windy) == ["the wind", "the drag of the air", "the spheres"]
    assert left_out(new_scene(mesh, drag=0.0, wind=(1, 0, 0))) == []
