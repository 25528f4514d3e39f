"""`clothfit evaluate`, also with --speed, and `clothfit check`: tables, summaries, advice, verdicts."""

import re
from dataclasses import replace

import pytest
from helpers.scenes import cloth, document, even, names, sphere, trial, write_scene

from clothfit import evaluate, load
from clothfit.cli.common.console import COMPILING
from clothfit.evaluation import work_precision as precision
from clothfit.evaluation.work_precision import grid

pytestmark = pytest.mark.slow

KEYS = {"schema_version", "command", "diverged", "frames", "rmse", "max_error", "horizon", "parameters"}
PARAMETER_KEYS = {"object", "name", "mode", "count", "median_relative_deviation", "max_relative_deviation"}
BOTH = "evaluate scene.json fitted.json"


@pytest.fixture
def scenes(here):
    """A scene, and one that is 10 % stiffer."""
    write_scene(here, even("LG"))
    write_scene(here, even("LG", springStiffness=[33.0] * 33), "fitted.json")
    return load("scene.json"), load("fitted.json")


def but_for_a_first_use(err):
    return err.replace(f"{COMPILING}\n", "")


def test_the_summary_has_the_keys_and_the_numbers_of_the_library(scenes, told):
    found, err = told(BOTH)
    report = evaluate(*scenes)
    assert (set(found), but_for_a_first_use(err)) == (KEYS, "")
    assert (found["frames"], found["rmse"], found["max_error"]) == (20, report.fitted.rmse, report.fitted.max_error)
    assert found["horizon"] == {"frames": 500, "rmse": report.horizon.rmse, "max_error": report.horizon.max_error}
    assert [set(p) for p in found["parameters"]] == [PARAMETER_KEYS] * 2
    assert found["parameters"][1]["max_relative_deviation"] == pytest.approx(0.1, rel=1e-12)  # rounding


def test_what_nothing_reveals_is_null_and_said(here, said, told):
    write_scene(here, even("LG", vertIsFixed=[True] * 16))
    found, _ = told("evaluate scene.json scene.json --steps 20")
    assert [d["max_relative_deviation"] for d in found["parameters"]] == [None, None]
    assert said("evaluate scene.json scene.json --steps 20")[1].count("not identifiable") == 4


def test_steps_are_those_of_the_longer_run_also_of_a_scene_from_standard_input(scenes, told, standard_input):
    standard_input("fitted.json")
    found, err = told("evaluate scene.json - --steps 60")
    assert (err, found["frames"], found["horizon"]["frames"]) == ("", 20, 61)


def test_a_longer_run_that_diverges_does_not_hide_the_fitted_frames(here, told):
    write_scene(here, even("nG", 5, integrationMethod=0, delta=0.004, springStiffness=[100.0] * 33))
    assert told("evaluate scene.json scene.json", code=4)[0]["rmse"] == 0.0


# --- evaluate --speed

SPEED_KEYS = {
    "schema_version", "command", "scene", "delta", "frames", "simulated_frames", "vertices", "reference", "rows", "own",
    "requested_error", "recommended", "plot",
}  # fmt: skip
ROW_KEYS = {
    "integrator", "step", "ratio", "tolerance", "newton_iterations", "status", "runs", "ms_per_step",
    "seconds_per_simulated_second", "error", "max_error", "own", "pareto",
}  # fmt: skip
QUICK = "evaluate scene.json --speed --steps 10 --budget 1"


@pytest.fixture(scope="module")
def measured():
    """What is measured of the scene, once for all tests."""
    return precision.work_precision(load(even("nG", 20)), 11, 1.0)


@pytest.fixture
def scene(here, monkeypatch, measured):
    """A scene that flags a stiffness; it was measured before."""

    def work_precision(scene, frames, seconds, report):
        assert (frames, seconds) == (11, 1.0)
        return replace(measured, scene=scene.name)

    monkeypatch.setattr(precision, "work_precision", work_precision)
    return load(write_scene(here, even("nG", 20)))


def test_the_summary_has_the_keys_of_speed_and_nothing_else_is_said(scene, told):
    found, err = told(f"{QUICK} --error 0.5")
    assert (set(found), but_for_a_first_use(err)) == (SPEED_KEYS, "")
    assert {frozenset(row) for row in found["rows"]} == {frozenset(ROW_KEYS)}
    assert set(found["reference"]) == {"integrator", "step", "order", "error"}
    assert (found["frames"], found["simulated_frames"], found["vertices"], found["delta"]) == (11, 11, 16, 0.02)
    assert len(found["rows"]) == len(grid(scene))
    assert [row for row in found["rows"] if row["own"]] == [found["own"]]
    assert [found["own"][key] for key in ("integrator", "newton_iterations", "step")] == ["implicit", 1, 0.02]
    near = [row for row in found["rows"] if row["status"] == "done" and row["error"] <= 0.5]
    assert found["recommended"] == min(near, key=lambda row: row["seconds_per_simulated_second"])
    assert (found["requested_error"], found["plot"]) == (0.5, None)


@pytest.mark.usefixtures("scene")
def test_the_table_marks_rows_and_says_what_a_fit_must_use(said):
    code, out, err = said(f"{QUICK} --error 0.5")
    lines = out.splitlines()
    assert (code, but_for_a_first_use(err), lines[0].split()[:2]) == (0, "", ["integrator", "step"])
    assert [line for line in lines if line.startswith("symplectic  h/4 = 5 ms")]
    assert out.count("the scene's own") == 1
    assert re.search(r"^\d+ more, with other tolerances", out, re.MULTILINE)
    for text in (
        "Pareto-best", "root mean square over all vertices and 11 frames; that motion is known to",
        "cheapest within 500 mm: ", "a fit must use the same (integrationMethod 2, delta 0.02)",
        "the editor plays this scene with implicit steps of h = 20 ms, tolerance 1e-05, 1 Newton iteration",
    ):  # fmt: skip
        assert text in out
    _, verbose, _ = said(f"{QUICK} -v")
    assert ("more, with other tolerances" in verbose, "1e-08" in verbose) == (False, True)
    assert said(f"{QUICK} -q") == (0, "", "")


@pytest.mark.usefixtures("scene")
def test_an_error_that_none_reaches_is_said(said, told):
    assert "warning: no setting comes within 0.001 nm; the nearest is " in said(f"{QUICK} --error 1e-12")[2]
    assert told(f"{QUICK} --error 1e-12")[0]["recommended"] is None


def test_what_diverged_is_listed(here, said):
    write_scene(here, trial("nn", 10, springStiffness=[2e3] * 33))
    code, out, _ = said(QUICK)
    assert code == 0
    assert re.search(r"^diverged: explicit h, h/2", out, re.MULTILINE)


@pytest.mark.usefixtures("scene")
def test_a_reference_that_is_not_known_to_the_end_is_said(said, told, monkeypatch, measured):
    less = replace(measured, scene="scene.json", reference=measured.reference.upto(6))
    monkeypatch.setattr(precision, "work_precision", lambda *_: less)
    assert "frames from 6 on (t = 0.12 s) are not judged" in said(QUICK)[2]
    found, _ = told(QUICK)
    assert (found["frames"], found["simulated_frames"]) == (6, 11)


@pytest.mark.usefixtures("scene")
def test_a_diagram_is_written(said, here):
    pytest.importorskip("matplotlib", reason="matplotlib is not installed; no picture is drawn")
    code, _, err = said(f"{QUICK} --plot speed.svg --error 0.01")
    assert (code, err.endswith("diagram → speed.svg\n")) == (0, True)
    assert (here / "speed.svg").read_bytes().startswith(b"<?xml")
    assert names() == ["scene.json", "speed.svg"]


# --- check: where the gradient is right, wrong, or cannot be judged

CHECK_KEYS = {
    "schema_version", "command", "scene", "verdict", "frames", "target", "flagged", "parameters", "tests",
    "longest_step", "left_out", "unseen", "seconds",
}  # fmt: skip
TESTS = ["Taylor", "difference", "dot product"]


@pytest.fixture
def touching(here):
    """A small scene with contact."""
    return write_scene(here, trial("LL", 30, 3, 3, colliders=[sphere(0.7, pos={"x": 1.0, "y": -0.75, "z": 1.0})]))


@pytest.mark.usefixtures("touching")
def test_a_right_gradient_is_told_line_by_line_and_in_the_summary(told):
    summary, err = told("check scene.json")
    lines = [line for line in err.splitlines() if not line.startswith("steps above")][-6:]
    what, header, *tests, last = lines
    assert what == (
        "gradient by objects[0] mass (L, 9 values), objects[0] stiffness (L, 16 values); 30 frames, against the motion "
        "of values up to 10 % off"
    )
    assert header.split() == ["test", "measured", "bar", "verdict"]
    assert [line.split("  ")[0] for line in tests] == TESTS
    assert all(line.endswith("passed") for line in tests)
    assert (last, names()) == ("scene.json: the gradient is right", ["scene.json"])  # nothing is written
    assert set(summary) == CHECK_KEYS
    assert [summary[key] for key in ("command", "verdict", "frames", "flagged")] == ["check", "passed", 30, True]
    assert [(test["name"], test["verdict"]) for test in summary["tests"]] == [(name, "passed") for name in TESTS]
    assert summary["tests"][0]["measured"] > summary["tests"][0]["bar"] == 1.9
    assert summary["tests"][1]["measured"] < summary["tests"][1]["bar"] == 1e-6
    assert summary["parameters"][0] == {"object": 0, "name": "mass", "mode": "L", "count": 9}
    assert summary["unseen"] == []


def test_what_is_not_flagged_and_what_does_not_act_is_told(here, told):
    """Masses and stiffnesses are checked where nothing is flagged; a flat cloth does not touch itself."""
    write_scene(here, trial("nn", 4, 3, 3, selfCollision={"thickness": 0.01}), "plain.json")
    summary, err = told("check plain.json")
    assert (summary["flagged"], [b["name"] for b in summary["parameters"]]) == (False, ["mass", "stiffness"])
    assert "plain.json flags nothing to fit: checked by all masses and stiffnesses\n" in err
    assert summary["unseen"] == ["self-contact"]
    assert "self-contact did not act in these frames" in err


def test_what_cannot_be_judged_is_neither_right_nor_wrong(here, told):
    write_scene(here, document(cloth(3, 3, vertIsFixed=[True] * 9), optimizationIterations=10))
    summary, err = told("check scene.json", code=3)
    assert summary["verdict"] == "unclear"
    assert "whether the gradient is right cannot be seen here" in err.splitlines()[-1]
    assert "try fewer or more --steps" in err


@pytest.mark.usefixtures("touching")
def test_a_large_cloth_is_looked_at_over_fewer_steps_and_that_is_said(said, told, monkeypatch):
    monkeypatch.setattr("clothfit.evaluation.gradient_check.CHECKED_VERTEX_STEPS", 90)
    code, _, err = said("check scene.json")
    assert (code, "the first 10 of 29 steps; --steps checks others\n" in err) == (0, True)
    assert told("check scene.json --steps 20")[0]["frames"] == 21
