"""What a process searches for: a recorded target, the values of a fit, forces through keys. Each function tells what it
finds by `tell(kind, **content)`, at the end with "done".
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from clothfit.scene.scene import Scene

OFTEN = 0.05
"""Seconds between two reports, at least."""

Tell = Callable[..., None]


def values_of(scene: Scene) -> dict[str, Any]:
    """What a fit may find, as `Scene.with_values` takes it."""
    own = {name: [getattr(cloth, name) for cloth in scene.cloths] for name in ("mass", "stiffness", "rest", "velocity")}
    own |= {name: [getattr(cloth, name) for cloth in scene.cloths] for name in ("damping", "drag")}
    shared = {name: np.array(getattr(scene, name)) for name in ("wind", "gravity", "friction", "contact")}
    return {"masses": own.pop("mass"), "stiffnesses": own.pop("stiffness"), **own, **shared}


def record(tell: Tell, scene: Scene) -> None:
    """Record the motion of a scene's own values, as a target."""
    from clothfit.fit.estimate import record_target

    tell("done", motion=record_target(scene))


def estimate(tell: Tell, scene: Scene, target: Any, budget: float | None) -> None:
    """Fit what a scene flags to a target, from the scene's values."""
    from clothfit.fit import estimate as fits

    last, shown = [0.0], [np.inf]

    def report(progress: Any) -> None:
        now = time.monotonic()
        better = progress.best is not None and progress.cost < shown[0]
        if not better and now < last[0] + OFTEN:
            return
        last[0] = now
        values = None
        if better:
            shown[0], values = progress.cost, values_of(progress.best())
        numbers = {name: finite(getattr(progress, name)) for name in ("cost", "rmse", "seconds")}
        counts = {name: getattr(progress, name) for name in ("evaluations", "iteration", "stage", "window", "frames")}
        tell("progress", figures={**numbers, **counts}, values=values)

    found = fits.estimate(scene, target, budget=budget, on_progress=report, keep_step=True)
    summary = {
        "status": str(found.status), "cost": finite(found.cost), "rmse": finite(found.rmse),
        "evaluations": found.evaluations, "seconds": finite(found.seconds),
    }  # fmt: skip
    tell("done", summary=summary, values=values_of(found.scene))


def control(tell: Tell, scene: Scene, keys: str, budget: float | None) -> None:
    """Find the forces that take a scene through keys, JSON as in a file."""
    from clothfit.control.control import find_forces
    from clothfit.control.keyframes import from_json

    found = find_forces(scene, from_json(keys, "keys", scene), budget=budget)
    summary = {
        "status": str(found.status), "effort": finite(found.effort), "evaluations": found.evaluations,
        "seconds": finite(found.seconds), "keys": [{"time": key.time, "rmse": finite(key.rmse)} for key in found.keys],
    }  # fmt: skip
    tell("done", summary=summary, forces=found.forces)


def finite(value: float) -> float | None:
    """A number as JSON has it."""
    return float(value) if np.isfinite(value) else None
