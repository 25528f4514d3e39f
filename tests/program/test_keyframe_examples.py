"""The examples of keyframes: they come from their generator, and belong to their scenes."""

from importlib.util import module_from_spec, spec_from_file_location

import pytest
from helpers.paths import EXAMPLES

import clothfit

FOLDER = EXAMPLES / "keyframes"


def test_the_files_are_what_the_generator_makes_and_there_are_no_others():
    spec = spec_from_file_location("keyframes_make", FOLDER / "make.py")
    make = module_from_spec(spec)
    spec.loader.exec_module(make)
    there = {path.name: path.read_text("ascii") for path in FOLDER.glob("*.json")}
    there.pop("curtain.keys.json")  # of a simulation, whose last digits depend on the machine
    assert there == make.files()


@pytest.mark.parametrize(
    ("scene", "name", "steps"),
    [(EXAMPLES / "flag.json", "flag", [50, 100]), (FOLDER / "sheet.json", "sheet", [60, 80]),
     (FOLDER / "curtain.json", "curtain", [100])],
)
def test_keys_belong_to_their_scene(scene, name, steps):
    loaded = clothfit.load(scene)
    keys = clothfit.load_keys(str(FOLDER / f"{name}.keys.json"), loaded)
    assert [key.step for key in keys] == steps
    assert loaded.warnings == ()
