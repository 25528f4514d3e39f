"""Whole journeys through the package's menu, with the real program: only flagged values differ afterwards."""

import json
import re
import time
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from helpers.files import leaves

from clothfit import load
from clothfit.cli.program import run

pytestmark = pytest.mark.slow  # starts a compiler and processes

SECONDS = 100
NAME = "Vorhang ü 窗"  # of the scene, so of its files
FITTED = re.compile(r"\.objects\[0\]\.(springStiffness\[\d+\]|damping)|\.windVel\.[xyz]")


@pytest.fixture
def project(tmp_path):
    return tmp_path / "Mein Projekt é 窗 $x"


def files(project):
    return sorted(path.name for path in (project / "Clothfit").iterdir())


def document(path):
    return leaves(json.loads(path.read_text("utf-8")))


def wait_for_end(line):
    """Wait until the process that a line names has ended, but for being asked for its exit code."""
    place = Path(f"/proc/{int(line.removeprefix('id: '))}/stat")
    end = time.monotonic() + SECONDS
    with suppress(FileNotFoundError):
        while place.read_text("utf-8").rpartition(") ")[2][0] != "Z":
            assert time.monotonic() < end
            time.sleep(0.05)


def test_export_estimate_import_changes_flagged_values_only(harness, project):
    said = harness.journey("fit", "trial", project)
    assert said[0] == "may start another: False"
    assert re.search(r"RMSE .* mm, \d+ evaluations", said[1])
    assert "undo: 5" in said  # the scene, two cloths, the fixer and the wind
    assert any(line.startswith("said: Clothfit: converged: RMSE") for line in said)
    assert f"progress: Clothfit: fits {NAME}: Succeeded" in said
    before = document(project / "Clothfit" / f"{NAME}.txt")
    fitted, after = document(project / "Clothfit" / f"{NAME}.fitted.txt"), document(project / "again.txt")
    assert after == fitted
    changed = {name for name in before if before[name] != after[name]}
    assert all(FITTED.fullmatch(name) for name in changed)
    found = {name: abs(after[name] - before[name]) for name in before if FITTED.fullmatch(name)}
    springs = [each for name, each in found.items() if "springStiffness" in name]
    assert np.median(springs) < 1e-2  # of 20 N/m: a trial finds its own values again, but for springs without motion
    assert max(each for name, each in found.items() if "springStiffness" not in name) < 1e-3  # of 0.1, and of m/s
    counts = re.search(r"springs: (\d+) colours: (\d+)", "\n".join(said))
    assert int(counts[1]) == sum(cloth.springs.shape[0] for cloth in load(str(project / "again.txt")).cloths)
    assert int(counts[2]) > 10


@pytest.mark.parametrize(("what", "code"), [("cancel", 0), ("quit", 0), ("abandon", 9)])
def test_a_fit_that_is_stopped_ends_and_keeps_the_best_also_when_the_editor_crashes(harness, project, what, code):
    line, *said = harness.journey(what, "long", project, code=code)
    wait_for_end(line)
    assert files(project) == [f"{NAME}.fitted.txt", f"{NAME}.txt"]
    if code == 0:
        assert said[0].startswith("said: Clothfit: interrupted: RMSE")
        assert said[1] == f"progress: Clothfit: fits {NAME}: Canceled"
        best = load(str(project / "Clothfit" / f"{NAME}.fitted.txt"))
        assert (best.cloths[0].stiffness != 1).any()
        assert "said: Clothfit: took the values of" in "\n".join(harness.journey("import", "long", project))


def test_what_is_missing_and_what_the_program_refuses_is_said(harness, project):
    assert harness.journey("try", "empty", project)[1] == "dialog: empty: there is no Clothfit Cloth in it"
    early = harness.journey("import", "trial", project)[1]
    assert early.endswith(f"{NAME}.fitted.txt does not exist; estimate first")
    said = harness("journey", "try", "trial", project, "no-such-program")[1]
    assert said.startswith("dialog: the program no-such-program was not found; say where it is in Edit > Preferences")
    said = harness.journey("lost", "trial", project)
    assert said[0].startswith("fault: Clothfit: no such file.npz: ")
    assert said[1] == f"progress: Clothfit: fits {NAME}: Failed"
    assert files(project) == [f"{NAME}.txt"]


def test_simulate_and_play(harness, project):
    said = harness.journey("play", "trial", project)
    assert f"progress: Clothfit: {NAME}: simulates: Succeeded" in said
    scene = project / "Clothfit" / f"{NAME}.txt"
    assert run(["simulate", str(scene), "-o", str(project / "m.npz"), "-q"]) == 0
    places = np.array([line.split() for line in said if re.match(r"[-\d]", line)], float)
    np.testing.assert_allclose(places, np.load(project / "m.npz")["positions"][7], atol=1e-6)  # float32
    start = [line.split(": ")[1].split() for line in said if line.startswith("second vertex")]
    firsts = [[each["vertPos"][1][axis] for axis in "xyz"] for each in json.loads(scene.read_text("utf-8"))["objects"]]
    np.testing.assert_array_equal(np.array(start, np.float32), np.float32(firsts))  # not that of the moved mesh


def test_a_target_is_shown_as_a_ghost(harness, project):
    harness.journey("try", "empty", project)
    harness("scene", "trial", project / "scene.txt")
    assert run(["target", str(project / "scene.txt"), "-o", str(project / "target.npz"), "-q"]) == 0
    said = harness.journey("target", "trial", project)
    assert said.count("mesh stays: True") == 2
    drawn = np.array([line.split() for line in said if re.match(r"[-\d]", line)], float)
    truth = np.load(project / "target.npz")["positions"][7]
    first, second = load(str(project / "scene.txt")).cloths
    corners = np.concatenate([first.triangles, second.triangles + len(first.positions)]).reshape(-1)
    np.testing.assert_allclose(drawn, truth[corners], atol=1e-6)  # float32
