"""Every error is in the table of `docs/errors.md`, every row of the table is an error, and each is provoked."""

import json
import re
import shlex
from importlib import import_module

import numpy as np
import pytest
from helpers.messages import CALLS, GAP, SILENT, pattern, raised, rows, templates
from helpers.paths import TESTS
from helpers.provoked import GOOD, SMALL
from helpers.staged import STAGED
from helpers.unasked import PYTHON

from clothfit.base.errors import ClothfitError
from clothfit.cli.program import run

ROWS = {row.message: row for row in rows()}
PROVOKED = [import_module(f"helpers.{path.stem}").COMMANDS for path in sorted((TESTS / "helpers").glob("provoked*.py"))]
COMMANDS = {message: case for cases in PROVOKED for message, case in cases.items()}
FOREIGN = list(COMMANDS)[:8]  # of the library that reads the command line


def test_every_message_of_the_program_has_a_row_and_every_row_a_message():
    found = templates()
    missing = {text: places for text, places in found.items() if text not in ROWS}
    assert missing == {}, "add them to docs/errors.md, which says how"
    assert set(ROWS) - set(found) == set(FOREIGN)


def test_every_exception_is_one_whose_words_are_looked_at():
    assert set(raised()) - set(CALLS) - set(SILENT) == set(), "tests/messages.py says what is to be done with it"


def test_every_row_is_provoked_once_and_nothing_else_is():
    assert sorted([*COMMANDS, *STAGED, *PYTHON]) == sorted(ROWS)


def filled(folder, files):
    """Write the files of a case."""
    for name, content in {"scene.json": SMALL, "good.npz": GOOD, **files}.items():
        path = folder / name
        path.parent.mkdir(exist_ok=True)
        if isinstance(content, bytes):
            path.write_bytes(content)
        elif name.endswith(".npz"):
            np.savez(path, **content)
        else:
            path.write_text(json.dumps(content), encoding="utf-8")


def tells(told, message):
    """Whether it is told, and no row that is more exact is."""
    exact = [row for row in ROWS if row != message and pattern(message).search(row)]
    return pattern(message).search(told) and not any(pattern(row).search(told) for row in exact)


@pytest.mark.parametrize("message", [*COMMANDS, *STAGED])
def test_a_command_ends_with_the_code_and_the_message_of_its_row(tmp_path, monkeypatch, capsys, message):
    case = {**COMMANDS, **STAGED}[message]
    filled(tmp_path, case.files)
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir() if path.is_file()}
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("CLOTHFIT_TRACEBACK", raising=False)
    case.prepare(monkeypatch)
    code = run(shlex.split(case.arguments))
    monkeypatch.undo()
    out, err = capsys.readouterr()
    last = err.splitlines()[-1]
    assert (str(code), out) == (ROWS[message].codes, "")
    assert last.startswith("error: ")
    assert tells(last, message)
    assert {name: (tmp_path / name).read_bytes() for name in before} == before  # nothing is written over


@pytest.mark.parametrize("message", PYTHON)
def test_a_call_raises_the_message_of_its_row(message):
    with pytest.raises(ClothfitError) as caught:
        PYTHON[message]()
    assert tells(str(caught.value), message)
    assert str(caught.value.exit_code) == ROWS[message].codes


def test_the_table_names_the_codes_that_the_readme_does():
    readme = (TESTS.parent / "README.md").read_text("utf-8")
    codes = {code for code, _ in re.findall(r"^\| (\d+) \| (.+) \|$", readme, re.MULTILINE)}
    assert {row.codes for row in ROWS.values()} <= codes


def test_no_row_is_a_part_of_words():
    assert all(re.search(r"\w", row.message.replace(GAP, "")) for row in ROWS.values())
