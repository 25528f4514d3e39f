"""Errors by family: representative commands end with the message and the exit code that docs/errors.md gives."""

import io
import re
import shlex

import numpy as np
import pytest
from helpers import failing_commands, failing_files
from helpers.failing import SMALL, pattern, rows
from helpers.paths import ROOT

import clothfit
from clothfit.base.errors import InvalidInput
from clothfit.cli.program import run
from clothfit.derivative import verify
from clothfit.meshes import mesh
from clothfit.meshes.mesh import Mesh

FAMILIES = {**failing_commands.FAMILIES, **failing_files.FAMILIES}
SLOW = {"together", "formats", "checkpoints", "divergence", "ends"}  # some of them compile a fit or start a process
CASES = [
    pytest.param(name, text, marks=[pytest.mark.slow] if name in SLOW else [])
    for name, family in FAMILIES.items()
    for text in family
]
SCENE, ONES = clothfit.load(SMALL), np.ones(3)
LINE = Mesh(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), np.array([(0, 1, 1)], np.int32))


RESULTS = ("check", "evaluate", "validate")
"""Commands whose result is a text, which may come before the error."""


@pytest.mark.parametrize(("family", "message"), CASES)
def test_a_command_that_fails_says_why_ends_with_its_code_and_writes_nothing_over(
    tmp_path, monkeypatch, capsys, family, message
):
    case = FAMILIES[family][message]
    case.fill(tmp_path)
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir() if path.is_file()}
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("CLOTHFIT_TRACEBACK", raising=False)
    case.prepare(monkeypatch)
    code = run(shlex.split(case.arguments))
    monkeypatch.undo()
    out, err = capsys.readouterr()
    last = err.splitlines()[-1]
    assert code == case.code
    assert out == "" or case.arguments.split()[0] in RESULTS
    assert last.startswith("error: ")
    assert pattern(message).search(last)
    assert {name: (tmp_path / name).read_bytes() for name in before} == before


def order(cost, direction=ONES):
    """The check of the derivative of a cost that is the same everywhere."""
    return verify.taylor_order(lambda p: cost, np.zeros(3), ONES, direction)


@pytest.mark.parametrize(
    ("message", "call"),
    [
        ("evaluations are too few, at least 1 is needed", lambda: clothfit.estimate(SCENE, max_evaluations=0)),
        ("targets: 0 are given for 1 scenes; give one item for each", lambda: clothfit.estimate_many([SCENE], [])),
        ("target: none is given; at least one motion is needed", lambda: clothfit.estimate(SCENE, [])),
        ("is not a number, an array of numbers or a scene", lambda: clothfit.estimate(SCENE, start=["a"])),
        ("objects; one each is needed", lambda: SCENE.with_values([], [])),
        ("items for 1 objects are given", lambda: SCENE.with_values([1], [1], drag=[])),
        ("up must be y or z; 'x' was given", lambda: clothfit.Reading(up="x")),
        ("half a surrogate pair; save it as UTF-8", lambda: clothfit.load(io.StringIO('{"a": "\ud800"}'))),
        ("a scene comes from a path, an open file or a dict, not from", lambda: clothfit.load(5)),
        ("have no coefficient; give a number", lambda: mesh.air_drag(LINE, 1.0)),
        ("derivative check: only 0 of", lambda: order(0.0)),
        ("derivative check: direction of shape (2,) given, p has (3,)", lambda: order(0.0, np.ones(2))),
        ("derivative check: the cost is nan near p; a finite one is needed", lambda: order(np.nan)),
    ],
)
def test_a_call_from_python_raises_invalid_input(message, call):
    with pytest.raises(InvalidInput, match=re.escape(message)):
        call()


def test_every_message_of_the_page_is_provoked_with_its_code():
    provoked = {text: case.code for family in FAMILIES.values() for text, case in family.items()}
    assert [row for row in rows() if provoked.get(row.message) != row.code] == []
    assert len(rows()) > 80


def test_every_family_is_provoked_and_the_page_has_the_exit_codes_of_the_readme():
    page, readme = ((ROOT / name).read_text("utf-8") for name in ("docs/errors.md", "README.md"))
    codes = [set(re.findall(r"^\| (\d+) \| ", text, re.MULTILINE)) - {"0", "5"} for text in (page, readme)]
    assert codes[0] == codes[1] == {str(case.code) for family in FAMILIES.values() for case in family.values()}
