"""Input from anybody leads to a documented exit code and one short message: by the list, and by mutation."""

import io
import json
import math
import os
import tracemalloc
from pathlib import Path
from random import Random

import jsonschema
import numpy as np
import pytest
from fuzz.__main__ import Report, generated
from fuzz.cases import CODES, COMMANDS, FOREIGN, Case, case, checkpoint_bytes, foreign_bytes, judged, tried, workplace
from fuzz.mutations import KINDS, motion, motion_bytes, scene, scene_bytes
from helpers.scenes import changed, load_text

from clothfit import load
from clothfit.base import memory
from clothfit.base.errors import InvalidMotion, InvalidScene
from clothfit.base.limits import FARTHEST
from clothfit.motion.motion import load_motion
from clothfit.scene import schema as structure
from clothfit.scene import text as source
from clothfit.scene.scene import WAY_OUT, dumps

pytestmark = pytest.mark.slow  # compiles a fit

TEXT = json.dumps(scene())


@pytest.fixture(scope="module", autouse=True)
def _workplace(tmp_path_factory):
    with workplace(str(tmp_path_factory.mktemp("hostile")), warm=False):
        yield


def refused(data, kind="scene"):
    """What is said of a file that must be refused."""
    verdict = tried(Case(kind, COMMANDS[kind][0], data), slow=math.inf)  # what is compiled meanwhile takes its time
    assert (verdict.code, verdict.faults) == (3, ())
    return verdict.message


# --- by the list

BROKEN = {
    "deep": (TEXT[:-1] + ', "x": ' + "[" * 65 + "]" * 65 + "}", "nested too deeply to be a scene (more than 64"),
    "repeated keys by the thousand": ('{"a": [' + '{"b": 1, "b": 2},' * 20_000 + "1]}", "the key b appears more than"),
    "more than 32 bits": (TEXT.replace('Iterations": 4', f'Iterations": {10**30}'), "it must be at most 2147483647"),
    "iterations": (TEXT.replace('"forwardSubSteps": 1', '"forwardSubSteps": 2000000000'), "of memory, "),
    "time": (TEXT.replace('"delta": 0.02', '"delta": 1e308'), "delta: 2 steps of 1e+308 s do not end at a finite time"),
}


@pytest.mark.parametrize(("text", "message"), BROKEN.values(), ids=list(BROKEN))
def test_scenes_that_are_too_much_are_refused(text, message):
    assert message in refused(text.encode())


def test_brackets_count_where_they_are_no_text():
    nested = TEXT[:-1] + ', "x": ' + "[" * 63 + '"]]\\"[[{{"' + "]" * 63 + ', "y": "' + "[{" * 99 + '"}'
    assert dumps(load_text(nested)).decode() == nested

    hidden = TEXT[:-1] + ', "x": ["' + "]" * 99 + '\\\\", ' + "[" * 70 + "]" * 71 + "}"
    with pytest.raises(InvalidScene, match="nested too deeply"):
        load_text(hidden)


def test_a_scene_larger_than_any_is_refused_unread(tmp_path):
    path = tmp_path / "sparse.json"
    with open(path, "wb") as file:
        os.truncate(file.fileno(), 10**12)
    verdict = judged(("simulate", str(path), "-o", "out.npz"), slow=math.inf)
    assert verdict.message == "error: sparse.json: cannot be read: it has more than the 500 MB that can be read\n"
    assert (verdict.code, verdict.faults) == (3, ())


def test_the_memory_that_a_scene_takes_is_foreseen(monkeypatch):
    monkeypatch.setattr(memory, "free", lambda: 10_000)
    with pytest.raises(InvalidScene, match=r"to read it takes about .* kB of memory, 10 kB are free"):
        source.parse(source.Source(TEXT), "x")


def test_what_is_foreseen_is_enough():
    """Parsed values never take more than is foreseen of them; three kinds of text, from long lists to short ones."""
    for text in ("[" + "1.5," * 9999 + "1]", "[" + "[]," * 9999 + "1]", json.dumps(scene()["objects"] * 20)):
        values = sum(size * text.count(mark) for mark, size in source.VALUE_BYTES.items())
        needed = values + source.TEXT_COPIES * len(text)
        tracemalloc.start()
        source.parse(source.Source(text), "x")
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert peak < 1.1 * needed


def test_a_motion_is_only_read_where_it_fits_into_memory(monkeypatch):
    file, own = io.BytesIO(), load_text(TEXT)
    np.savez(file, **motion())
    monkeypatch.setattr(memory, "free", lambda: 1000)
    monkeypatch.setattr(memory, "ALWAYS_FREE", 0)  # less is not looked at otherwise
    Path("motion.npz").write_bytes(file.getvalue())
    with pytest.raises(InvalidMotion, match=r"takes 1\.45 kB of memory, 1 kB are free; keep fewer frames"):
        load_motion("motion.npz", own)


def test_names_that_cannot_be_are_refused():
    for name in ("a\0b", "x" * 5000, "", "\udcff", "@", "a@", "@a"):
        for arguments in (("--target", name), ("--start", name), ("--target", f"good.npz@{name}")):
            verdict = judged(("estimate", "good.json", *arguments, "-o", "out.json"), slow=math.inf)
            assert verdict.code == 3
            assert verdict.message.splitlines()[-1].startswith("error: ")


def test_planes_by_the_thousand_get_one_warning():
    crowd = changed(scene(), ("colliders",), scene()["colliders"][1:] * 1000)
    assert load(crowd).warnings == (
        f"colliders[0]: planes are ignored, as in the editor (and 999 more); {WAY_OUT}",
    )


# --- by mutation


def chances(name, count):
    """So many sources of chance, the same at every run: to try others is what `make fuzz` is for."""
    return [Random(f"{name}-{number}") for number in range(count)]


MUTATED = {  # how many, and how one is made
    "scene": (80, lambda chance: (chance.choice(COMMANDS["scene"]), scene_bytes(chance))),
    "moving": (80, lambda chance: (("info", "{file}"), KINDS["moving"](chance))),
    "motion": (80, lambda chance: (COMMANDS["motion"][0], motion_bytes(chance))),
    "foreign": (40, lambda chance: other_program(chance, chance.choice(FOREIGN))),
    "checkpoint": (20, lambda chance: (COMMANDS["checkpoint"][0], checkpoint_bytes(chance))),
}


def other_program(chance, suffix):
    return chance.choice(COMMANDS["foreign"]), foreign_bytes(chance, suffix), suffix


@pytest.mark.parametrize("kind", MUTATED)
def test_mutated_files_end_with_a_documented_code(kind):
    count, made = MUTATED[kind]

    for number, chance in enumerate(chances(kind, count)):
        verdict = tried(Case(kind, *made(chance)), slow=math.inf)
        assert verdict.code in CODES, number
        assert verdict.faults == (), number


def test_a_scene_that_is_taken_obeys_the_schema_and_can_be_saved():
    judge, count = jsonschema.Draft202012Validator(json.loads(structure.schema_path().read_text())), 0
    for chance in chances("taken", 150):
        data = scene_bytes(chance)
        try:
            taken = load_text(data)
        except InvalidScene:
            continue
        judge.validate(json.loads(taken.source.text))
        for cloth in taken.cloths:
            for array in (cloth.positions, cloth.mass, cloth.stiffness, cloth.rest, cloth.velocity):
                assert np.isfinite(array).all()
            assert ((cloth.springs >= 0) & (cloth.springs < len(cloth.mass))).all()
        assert dumps(taken) == data
        count += 1
    assert count > 10


def test_a_motion_that_is_taken_fits_its_scene():
    taken_of, count = load_text(TEXT), 0
    for chance in chances("fits", 150):
        try:
            taken = load_motion(io.BytesIO(motion_bytes(chance)), taken_of)
        except InvalidMotion:
            continue
        frames, vertices, _ = taken.positions.shape
        assert (vertices, taken.positions.dtype) == (13, np.float64)
        seen = np.ones((frames, vertices), bool) if taken.observed is None else taken.observed
        assert (np.abs(taken.positions[seen]) < FARTHEST).all()
        assert (np.diff(taken.times) > 0).all()
        count += 1
    assert count > 10


def test_the_generator_gives_the_same_cases_again(tmp_path):
    first, second = ([case(Random(f"0-{i}"), moving=False) for i in range(30)] for _ in range(2))
    assert first == second
    report = Report(tmp_path / "faults")
    generated(report, seed=0, count=30, seconds=0.0, moving=False)
    assert (report.count, set(report.codes) <= set(CODES)) == (30, True)
