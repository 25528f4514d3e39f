"""What the tests of controls share."""

import pytest
from helpers.physics import METHODS, scene, xyz
from helpers.scenes import cloth


@pytest.fixture(scope="session")
def flag():
    """What makes a 4 by 3 cloth in wind, two corners held."""

    def made(method="implicit", **fields):
        given = {"windVel": xyz((3, 1, -2)), "delta": 0.02, "tolerance": 1e-12, **fields}
        late = method in ("implicit", "bdf2")  # others are unstable with drag and damping
        drag, damping = (0.1, 0.3) if late else (0.0, 0.0)
        one = cloth(dragCoefficient=drag, damping=damping, springStiffness=[20.0] * 23)
        return scene(one, integrationMethod=METHODS[method], **given)

    return made
