"""The add-on for Blender from end to end, in Blender as a Python module: installed, fitted, played, applied, cancelled.

CLOTHFIT_BPY names a Python that has one (`pip install bpy==4.2.23 'numpy<2'` for Python 3.11); else this skips.
"""

import json
import os
import subprocess
import sys
import tomllib
import zipfile

import numpy as np
import pytest
from helpers.paths import EXAMPLES, TESTS
from helpers.scenes import environment

from clothfit import load
from clothfit.base.version import __version__

ADDON = EXAMPLES / "blender" / "clothfit"
SOURCES = sorted(ADDON.glob("*.py"))
SECONDS = 600


def test_the_manifest_is_of_this_version_and_of_blender_4_2():
    manifest = tomllib.loads((ADDON / "blender_manifest.toml").read_text("utf-8"))
    assert (manifest["id"], manifest["version"], manifest["type"]) == ("clothfit", __version__, "add-on")
    assert manifest["blender_version_min"] == "4.2.0"
    assert len(manifest["tagline"]) <= 64  # Blender refuses longer ones, and those that end with a full stop


def test_the_add_on_uses_blender_and_python_only():
    allowed = {"bpy", "numpy", *sys.stdlib_module_names}
    lines = [line.split() for path in SOURCES for line in path.read_text("utf-8").splitlines()]
    used = {words[1].split(".")[0] for words in lines if words[:1] in (["import"], ["from"]) and words[1][0] != "."}
    assert used <= allowed


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    python = os.environ.get("CLOTHFIT_BPY")
    if python is None:
        pytest.skip("no Blender as a Python module; name a Python that has one by CLOTHFIT_BPY")
    folder = tmp_path_factory.mktemp("add-on")
    with zipfile.ZipFile(folder / "clothfit.zip", "w") as archive:
        for path in [*SOURCES, ADDON / "blender_manifest.toml"]:
            archive.write(path, f"clothfit/{path.name}")
    work = folder / "Stoff ü mit Raum"
    own = environment(BLENDER_USER_RESOURCES=str(folder / "user"))
    call = [python, str(TESTS / "blender" / "journey.py"), str(folder / "clothfit.zip"), str(work)]
    done = subprocess.run([*call, f"{sys.executable} -m clothfit"], env=own, capture_output=True, text=True,
                          check=False, timeout=SECONDS)  # fmt: skip
    lines = [line for line in done.stdout.splitlines() if line.startswith("found: ")]
    assert lines, done.stdout + done.stderr
    return {**json.loads(lines[0].removeprefix("found: ")), "folder": work}


def points(path):
    """Positions (20, n, 3) of a PC2 file, y up, right-handed; of a fit in shorter steps those of the frames."""
    header = 32  # bytes
    steps = int(np.fromfile(path, "<i4", count=8)[7])
    return np.fromfile(path, "<f4", offset=header).reshape(steps, -1, 3)[:: (steps - 1) // 19]


@pytest.mark.slow
def test_what_is_missing_is_said(found):
    assert "save the file first" in found["unsaved"]
    assert "the program 'no-such-program' was not found" in found["lost"]
    assert "cloth.fitted.json does not exist; fit first" in found["early"]
    assert "clothfit runs already" in found["twice"]
    assert found["missing"][-1].startswith("error: no such file.pc2: ")


@pytest.mark.slow
def test_the_cloth_of_blender_is_fitted_and_the_result_plays_beside_it(found):
    assert any("RMSE" in said and "of 20 frames" in said for said in found["fit"])
    assert found["fit"][-1].split(":")[0] in ("converged", "stalled", "limit")
    scene = load(str(found["folder"] / "cloth.json"))
    assert scene.frames == 20
    assert scene.cloths[0].fixed.sum() == 8
    motion, target = (points(found["folder"] / f"first.{kind}.pc2") for kind in ("fitted", "target"))
    x, y, z = motion[9].T  # frame 12, of which 3 is the first
    np.testing.assert_allclose(found["played"], np.stack([x, -z, y], axis=1), atol=1e-6)  # float32
    first = scene.cloths[0].positions * [-1, 1, 1]  # right-handed
    np.testing.assert_allclose(target[0], first, atol=1e-6)  # float32
    apart, travel = np.linalg.norm(motion - target), np.linalg.norm(target - target[0])
    assert travel > 0.1 * len(target[0]) ** 0.5  # it falls
    assert apart < 0.1 * travel  # another model of cloth: near, not the same
    assert found["moved"][0] > 1


@pytest.mark.slow
def test_values_are_applied_and_shown(found):
    before, mass, tension, quality = found["values"]
    assert mass != before
    assert tension > 0
    assert quality >= 1
    assert found["speed"] == pytest.approx(1, rel=1e-5)  # as it was: the fit took the cloth's own time
    assert found["pin"] == "clothfit pin"
    assert found["colours"] > 1


@pytest.mark.slow
def test_a_cancelled_fit_keeps_the_best(found):
    assert found["cancel"][-1].startswith("interrupted: RMSE")
    stiffness = load(str(found["folder"] / "cloth.fitted.json")).cloths[0].stiffness
    assert (stiffness != 1).any()
    target = points(found["folder"] / "cloth.target.pc2")  # of the object that plays beside the cloth
    np.testing.assert_allclose(target, points(found["folder"] / "first.fitted.pc2"), atol=1e-5)  # float32, and back
