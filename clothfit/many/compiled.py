"""Whether the program is compiled for this machine, and how one process does it before many need it at once."""

from __future__ import annotations

from typing import Any

GRADIENT = "derivative.adjoint.sweep_back-*"  # files of the cache that any fit by gradients leaves


def cold() -> bool:
    """Whether fits would have to be compiled first."""
    from clothfit.kernels.cache import config, usable

    return not config.DISABLE_JIT and not any(any(folder.glob(GRADIENT)) for folder in usable())


def warm(nothing: object = None) -> None:
    """Compile what fits use, by one of a small cloth; the others find it in the cache. Takes some 20 s."""
    from clothfit.fit.estimate import estimate
    from clothfit.scene.scene import load

    scene = load(small_cloth())
    estimate(scene, start=0.5, budget=5)
    estimate(scene, start=0.5, budget=2, method="l-bfgs-b", intervals=False)


def small_cloth() -> dict[str, Any]:
    """A square of four vertices over a sphere, in the wind."""
    zero = {"x": 0.0, "y": 0.0, "z": 0.0}
    cloth = {
        "vertPos": [{"x": float(i), "y": 0.1 * i * j, "z": float(j)} for j in (0, 1) for i in (0, 1)],
        "vertIsFixed": [True, False, False, False],
        "vertMass": [0.02] * 4,
        "springs": [0, 1, 0, 2, 1, 3, 2, 3, 0, 3],
        "springStiffness": [20.0, 30.0, 25.0, 20.0, 10.0],
        "triangles": [0, 2, 3, 0, 3, 1],
        "dragCoefficient": 0.1,
        "damping": 0.1,
        "optimizationSettings": "LL",
    }
    return {
        "title": "small",
        "integrationMethod": 2,
        "delta": 0.02,
        "tolerance": 1e-5,
        "optimizationIterations": 12,
        "forwardSubSteps": 1,
        "windVel": {"x": 1.0, "y": 0.5, "z": 0.2},
        "objects": [cloth],
        "colliders": [{"type": 1, "pos": zero, "rot": zero, "scale": {"x": 0.2, "y": 0.2, "z": 0.2}}],
    }
