"""What is installed: the schema is found in a checkout and from a wheel, and a wheel holds the package and no more."""

import os
import re
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from pathlib import Path

import pytest
from helpers.paths import ROOT

import clothfit
from clothfit.scene import schema as structure

pytestmark = pytest.mark.slow  # starts processes

PACKAGE = ROOT / "clothfit"
WHERE = "from clothfit.scene.schema import defaults, schema_path as at; print(at(), len(defaults('scene')))"


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """A wheel of this checkout, built without an environment of its own."""
    builder = pytest.importorskip("hatchling.builders.wheel", reason="hatchling is not installed; no wheel is built")
    folder = tmp_path_factory.mktemp("wheel")
    (path,) = builder.WheelBuilder(str(ROOT)).build(directory=str(folder), versions=["standard"])
    return Path(path)


@pytest.fixture(scope="module")
def sdist(tmp_path_factory):
    """A source distribution of this checkout."""
    builder = pytest.importorskip("hatchling.builders.sdist", reason="hatchling is not installed; no sdist is built")
    (path,) = builder.SdistBuilder(str(ROOT)).build(directory=str(tmp_path_factory.mktemp("sdist")))
    return Path(path)


@pytest.fixture(scope="module")
def names(wheel):
    """The files in the wheel."""
    with zipfile.ZipFile(wheel) as archive:
        return archive.namelist()


def test_the_version_is_written_once_and_the_entry_point_exists():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    source = (PACKAGE / "base" / "version.py").read_text("utf-8")
    assert re.findall(r'^__version__ = "(.+)"$', source, re.MULTILINE) == [clothfit.__version__]
    assert "version" in project["dynamic"]
    module, _, name = project["scripts"]["clothfit"].partition(":")
    assert callable(getattr(__import__(module, fromlist=[name]), name))


def test_a_wheel_holds_every_module_the_schema_the_marker_and_the_parts_of_a_report_and_nothing_else(names):
    own = [*PACKAGE.rglob("*.py"), *(path for path in (PACKAGE / "report" / "web").rglob("*") if path.is_file())]
    parts = {f"clothfit/{path.relative_to(PACKAGE).as_posix()}" for path in own}
    assert sum("/report/web/" in part for part in parts) > 15
    assert parts | {"clothfit/py.typed", "clothfit/schemas/scene.schema.json"} <= set(names)
    assert {name.split("/")[0] for name in names} == {"clothfit", f"clothfit-{clothfit.__version__}.dist-info"}
    assert [name for name in names if "test" in name.lower() or "__pycache__" in name] == []


def test_a_wheel_carries_the_licence_and_the_command(wheel):
    info = f"clothfit-{clothfit.__version__}.dist-info"
    with zipfile.ZipFile(wheel) as archive:
        assert archive.read(f"{info}/licenses/LICENSE") == (ROOT / "LICENSE").read_bytes()
        assert b"clothfit = clothfit.__main__:main" in archive.read(f"{info}/entry_points.txt")
        assert b"License-Expression: MIT" in archive.read(f"{info}/METADATA")


def test_the_schema_is_found_from_an_unpacked_wheel(wheel, tmp_path):
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(tmp_path)
    environment, call = {**os.environ, "PYTHONPATH": str(tmp_path)}, [sys.executable, "-c", WHERE]
    done = subprocess.run(call, env=environment, cwd=tmp_path, capture_output=True, text=True, check=True)
    place, count = done.stdout.split()
    assert place == str(tmp_path / "clothfit" / "schemas" / "scene.schema.json")
    assert int(count) == len(structure.defaults("scene")) > 5
    assert structure.schema_path() == ROOT / "schemas" / "scene.schema.json"  # of a checkout


def test_a_source_distribution_holds_what_is_needed_to_build_test_and_try(sdist):
    with tarfile.open(sdist) as archive:
        found = {name.partition("/")[2] for name in archive.getnames()}
    assert {
        "pyproject.toml", "README.md", "CHANGELOG.md", "LICENSE", "Makefile", "clothfit/py.typed",
        "schemas/scene.schema.json", "examples/make.py", "examples/side.json", "tests/helpers/scenes.py",
        "tests/meshes/test_mesh.py",
    } <= found  # fmt: skip
    folders = {"clothfit", "schemas", "examples", "tests", "docs", "benchmarks"}  # docs: the README shows a picture
    assert {name.split("/")[0] for name in found if "/" in name} == folders
