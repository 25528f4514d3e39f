"""What holds for all tests."""

import gc
import os
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest
from helpers.paths import TESTS
from helpers.scenes import trial, write_scene

from clothfit.base import interrupts, threads
from clothfit.kernels.helper import ALONE

gc.disable()  # until all tests are collected

if "PYTEST_XDIST_WORKER" in os.environ:  # the others compile as well: no process needs a helper
    os.environ[ALONE] = "1"


def pytest_configure(config: pytest.Config) -> None:
    """Let each of several processes begin to collect all tests at another folder: a module whose asserts one of them
    has rewritten the others read as it is.
    """
    worker = getattr(config, "workerinput", None)
    if worker and [Path(each).resolve() for each in config.args] == [TESTS]:
        folders = sorted(str(each) for each in TESTS.iterdir() if each.is_dir() and not each.name.startswith("_"))
        first = int(worker["workerid"][2:]) * len(folders) // worker["workercount"]
        config.args = folders[first:] + folders[:first]


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark as quick what is not marked as slow, so that `-m quick` selects it; in one order."""
    items.sort(key=lambda item: item.path)
    for item in items:
        if item.get_closest_marker("slow") is None:
            item.add_marker("quick")


def pytest_collection_finish() -> None:
    """Leave what all tests are made of out of the search for garbage: it took a fifth of the time of compiling."""
    gc.freeze()
    gc.enable()
    gc.set_threshold(20_000)


@pytest.fixture(scope="session", autouse=True)
def _requests_are_heard() -> Iterator[None]:
    """The handlers of requests to end that tests count on, and that processes which they start begin with: whoever runs
    the tests in the background (`nohup make test &`) has them ignored.
    """
    wanted = dict.fromkeys(interrupts.REQUESTS, signal.SIG_DFL) | {signal.SIGINT: signal.default_int_handler}
    before = {kind: signal.signal(kind, handler) for kind, handler in wanted.items()}
    yield
    for kind, handler in before.items():
        signal.signal(kind, handler)


@pytest.fixture(scope="session", autouse=True)
def _one_thread() -> Iterator[None]:
    """Dense algebra of small matrices on one thread, as in a fit: more of them wait for each other."""
    with threads.single():
        yield


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder to work in, with a scene."""
    monkeypatch.chdir(tmp_path)
    write_scene(tmp_path, trial("nG", 5))
    return tmp_path
