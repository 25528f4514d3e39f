"""The grids of `scaling.py`: square cloths of the same size, weight and springs, finer and finer."""

from __future__ import annotations

import io
import json
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from clothfit.scene.scene import Scene

SIZE, DENSITY = 7.0, 0.1  # m, and kg/m²: 4.9 kg in all
STRUCTURAL, BENDING = 50.0, 12.5  # N/m, of the springs along edges, diagonal ones included, and of those across them
DAMPING, DRAG, STEP, TOLERANCE = 0.1, 0.1, 0.02, 1e-5


def grid(side: int, frames: int) -> Scene:
    """A level cloth of side × side vertices held at one side; its stiffnesses are fitted, `frames` compared."""
    import clothfit
    from clothfit.meshes.mesh import object_document, plane, springs

    mesh = plane(side - 2, SIZE)
    z = mesh.positions[:, 2]
    cloth = object_document(
        mesh, z == z.max(), density=DENSITY, stiffness=1.0, damping=DAMPING, drag=DRAG, settings="nL"
    )
    cloth["springStiffness"] = np.where(springs(mesh, 1.0).bends, BENDING, STRUCTURAL).tolist()
    document = {
        "title": f"grid {side}²",
        "integrationMethod": 2,
        "delta": STEP,
        "tolerance": TOLERANCE,
        "optimizationIterations": frames,
        "forwardSubSteps": 1,
        "printTimes": False,
        "windVel": {"x": 0.0, "y": 0.0, "z": 0.0},
        "objects": [cloth],
        "colliders": [],
    }
    return clothfit.load(io.StringIO(json.dumps(document)))
