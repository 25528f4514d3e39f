"""What the tests of the engine share."""

import numpy as np
import pytest
from helpers.surfaces import torus


@pytest.fixture(scope="session")
def wobble(tmp_path_factory: pytest.TempPathFactory) -> str:
    """The file of a motion of a torus that bends and swells."""
    points = torus(12, 8, 0.8, 0.4)[0]
    t = np.linspace(0, 0.2, 6)[:, None, None]
    swollen = points * (1 + 0.8 * t * np.array([1.0, 0.5, -0.7])) + 0.3 * t * np.sin(3 * points[:, ::-1])
    path = tmp_path_factory.mktemp("motion") / "wobble.npz"
    np.savez(path, positions=swollen, times=t.reshape(-1))
    return str(path)
