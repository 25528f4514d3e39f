"""Compiling ahead of time all that commands can need: for images, for continuous integration, for the impatient.

What is compiled depends on the types of arguments only, so a cloth of four vertices that goes every way once compiles
the same as one of ten thousand.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np
from numba.core import event
from numba.core.registry import CPUDispatcher

from clothfit.capture import degrade
from clothfit.compiled import small_cloth
from clothfit.fit import estimate, record_target
from clothfit.fit_vector import parameters
from clothfit.motion import simulate
from clothfit.objective import Objective
from clothfit.scene import Scene, load

STEP = 0.001  # s, short, so that explicit steps stay stable
KINDS = {"damping": "G", "dragCoefficient": "G", "vertVel": "L", "springRestLength": "L"}  # what else to fit


class Part(NamedTuple):
    """One part of the program, and what it took to compile it."""

    name: str
    compiled: int  # functions, each time for other types
    seconds: float


def warm_up(report: Callable[[Part], None] = lambda part: None) -> list[Part]:
    """Compile everything that is not compiled yet, part by part; `report` is called after each."""
    parts = []
    for name, use in PARTS.items():
        began = time.perf_counter()
        with compilations() as found:
            use()
        parts.append(Part(name, len(found), time.perf_counter() - began))
        report(parts[-1])
    return parts


@contextmanager
def compilations() -> Iterator[list[str]]:
    """Collect the names of the functions that are compiled within the block."""
    found: list[str] = []

    class Listener(event.Listener):
        def on_start(self, event: Any) -> None:
            dispatcher = event.data["dispatcher"]
            if isinstance(dispatcher, CPUDispatcher):  # not calls back into Python, prepared anew by every process
                found.append(f"{dispatcher.py_func.__module__}.{dispatcher.py_func.__name__}")

        def on_end(self, event: Any) -> None:
            pass

    listener = Listener()
    event.register("numba:compile", listener)
    try:
        yield found
    finally:
        event.unregister("numba:compile", listener)


def small_scene(settings: str = "LL", cloth_fit: dict[str, str] | None = None, **fields: Any) -> Scene:
    """A scene with all that can act on a cloth, six frames long; `fields` are those of the file."""
    whole = {**small_cloth(), "delta": STEP, "optimizationIterations": 6, **fields}
    (cloth,) = whole["objects"]
    return load({**whole, "objects": [{**cloth, "optimizationSettings": settings, "fit": cloth_fit or {}}]})


def _simulations() -> None:
    for method in (0, 1, 2):
        simulate(small_scene(integrationMethod=method))


def _gradients() -> None:
    scene = small_scene(cloth_fit=KINDS)
    objective, p = Objective(scene, simulate(scene)), parameters(scene)
    objective.cost_and_gradient(p)
    objective.tangent(p, np.ones_like(p))


def _fits() -> None:
    for method in ("auto", "gauss-newton", "l-bfgs-b"):
        estimate(small_scene(), method=method, budget=4)
    scene = small_scene()
    estimate(scene, degrade(record_target(scene), noise=1e-3, observed=0.5), budget=4)
    estimate(small_scene("GG"), budget=4)


def _fits_of_all_kinds() -> None:
    for method in (0, 2):
        scene = small_scene(cloth_fit=KINDS, fit={"windVel": True, "gravity": True}, integrationMethod=method)
        estimate(scene, method="gauss-newton", budget=4)


PARTS: dict[str, Callable[[], None]] = {
    "simulation": _simulations,
    "gradient": _gradients,
    "fits": _fits,
    "fits of other kinds": _fits_of_all_kinds,
}
