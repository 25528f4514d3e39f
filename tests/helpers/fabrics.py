"""Scenes of fabrics."""

import io
import json

import numpy as np

from clothfit import load, new_scene
from clothfit.fabric.fabric import woven
from clothfit.meshes.mesh import Mesh

BENT = 1e-4  # N m


def scene(mesh, fixed=None, density=0.2, stretch=(200.0,) * 3, bend=(BENT,) * 3, gravity=-9.81, **more):
    """A scene of a fabric; flat springs push, which a step of second order follows with two Newton iterations."""
    positions, faces = mesh
    fixed = np.zeros(len(positions), bool) if fixed is None else fixed
    own = woven(positions, faces, density, stretch, bend, fixed)
    made = new_scene(Mesh(positions, faces), fixed, density=density, bending=False, drag=0.0, **more)
    document = json.loads(made.source.text)
    document["objects"][0] |= {
        "springs": own.ends.reshape(-1).tolist(), "springStiffness": own.stiffness.tolist(),
        "springRestLength": own.rest.tolist(), "vertMass": own.mass.tolist(),
    }  # fmt: skip
    document |= {"gravity": {"x": 0, "y": gravity, "z": 0}, "forwardSubSteps": 2}
    return load(io.StringIO(json.dumps(document)))
