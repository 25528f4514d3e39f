"""What the tests of commands share: something on standard input, and a recorder in the place of the fit."""

import io
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest
from helpers.scenes import even

from clothfit.fit.estimate import estimate
from clothfit.scene.scene import load


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

    monkeypatch.setattr("clothfit.fit.estimate.fit", fit)
    return asked
