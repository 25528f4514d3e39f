"""What the tests of commands share: a folder, commands in this process, a recorder in the place of the fit."""

import io
import json
import shlex
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest
from helpers.scenes import even

from clothfit import estimate, load
from clothfit.cli.program import run


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    """The current folder, which is empty."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def said(capsys):
    """Runs a command, all in one string; gives exit code, standard output and standard error."""

    def ended(line, more=()):
        return run([*shlex.split(line), *more]), *capsys.readouterr()

    return ended


def refuse(constant):
    raise AssertionError(f"{constant} is not JSON")


@pytest.fixture
def told(said):
    """The summary that a command prints with --json when it ends with that code, and its messages."""

    def summary(line, code=0):
        ended, out, err = said(f"{line} --json")
        assert ended == code, err
        return json.loads(out, parse_constant=refuse), err

    return summary


@pytest.fixture
def summary(told):
    """The same without the messages."""
    return lambda line, code=0: told(line, code)[0]


class Named(io.BytesIO):
    """What is read, with the name that Python gives to standard input."""

    name = "<stdin>"


@pytest.fixture
def standard_input(monkeypatch):
    """Puts what a file holds on the standard input of this process."""

    def put(path):
        monkeypatch.setattr(sys, "stdin", SimpleNamespace(buffer=Named(Path(path).read_bytes())))

    return put


@pytest.fixture(scope="session")
def found():
    """The fit of a cloth of nine vertices."""
    return estimate(load(even("nG", 5, 3, 3)))


@pytest.fixture
def fits(monkeypatch, found):
    """What a recorder in the place of the fit was asked for, one item a fit. It finds the values of the scene."""
    asked = []

    def fit(scene, targets=None, start=None, options=None):
        asked.append(SimpleNamespace(scene=scene, targets=targets, start=start, options=options))
        return replace(found, scene=scene)

    monkeypatch.setattr("clothfit.fit.estimate.by_request", fit)
    return asked
