"""The harness that uses the Unity package, compiled once."""

import shutil

import pytest
from helpers.unity import Harness, built


@pytest.fixture(scope="session")
def harness(tmp_path_factory: pytest.TempPathFactory) -> Harness:
    if shutil.which("mcs") is None or shutil.which("mono") is None:
        pytest.skip("mono is not installed")
    return built(tmp_path_factory.mktemp("unity"))
