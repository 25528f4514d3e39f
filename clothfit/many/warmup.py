"""Compiling ahead of time all that commands can need: for images, for continuous integration, for the impatient.

What is compiled depends on the types of arguments only, so a strip of a few vertices that goes every way once compiles
the same as a cloth of thousands. Large cloths are solved with other types, and very large ones with others again: for
these the strip is called large.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from typing import Any, NamedTuple

import numba
import numpy as np
from numba.core import event
from numba.core.registry import CPUDispatcher, cpu_target

from clothfit.engine.solve import cg_two_threads, sparse
from clothfit.engine.step import implicit
from clothfit.engine.system import build
from clothfit.evaluation import runge_kutta
from clothfit.fit.estimate import estimate, record_target
from clothfit.kernels import cache as kernel_cache
from clothfit.kernels.cache import KernelCache
from clothfit.motion.degrade import degrade
from clothfit.motion.energy import energies
from clothfit.motion.simulate import simulate
from clothfit.objective.objective import Objective
from clothfit.scene.fit_vector import parameters
from clothfit.scene.scene import Scene, load

STEP = 0.001  # s, short, so that explicit steps stay stable
FITTED_KINDS = {"damping": "G", "dragCoefficient": "G", "vertVel": "L", "springRestLength": "L"}  # what else to fit
EVERYWHERE = {"windVel": True, "gravity": True}
LARGE_FROM, NEVER = 10, 2**31  # vertices


class Part(NamedTuple):
    """One part of the program, and what it took to compile it."""

    name: str
    compiled: int  # functions, each time for other types
    seconds: float


def warm_up(report: Callable[[Part], None] = lambda part: None, small: bool = False) -> list[Part]:
    """Compile what is not compiled yet, part by part; `report` is called after each.

    Everything, or with `small` only what cloths need that are not large. That it was done is noted beside the code,
    with the names of its files: where they are all there nothing is done.
    """
    processor = cpu_target.target_context.codegen().magic_tuple()
    note = kernel_cache.file_name("warmup", small, processor)
    noted = kernel_cache.load(note)
    if noted is not None and all(kernel_cache.load(name) for name in noted[1].decode().split()):
        KernelCache.used = noted[0]
        return [Part(name, 0, 0.0) for name in (SMALL_PARTS if small else PARTS)]
    parts = use_everything(report, small)
    if not KernelCache.failed:
        with suppress(OSError):  # then it is done again the next time
            KernelCache.used = kernel_cache.save(note, "\n".join(sorted(KernelCache.names)).encode())
    return parts


def use_everything(report: Callable[[Part], None], small: bool) -> list[Part]:
    """Run all that is compiled."""
    parts = []
    for name, use in (SMALL_PARTS if small else PARTS).items():
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


@contextmanager
def called(large: bool, very_large: bool) -> Iterator[None]:
    """Within, every cloth is taken for a large or a very large one, or none is."""
    before = sparse.TWO_THREADS_FROM, sparse.MULTIGRID_FROM
    sparse.TWO_THREADS_FROM = LARGE_FROM if large else NEVER
    sparse.MULTIGRID_FROM = LARGE_FROM if very_large else NEVER
    try:
        yield
    finally:
        sparse.TWO_THREADS_FROM, sparse.MULTIGRID_FROM = before


def strip_scene(settings: str = "LL", kinds: dict[str, str] | None = None, **fields: Any) -> Scene:
    """A strip in the wind over a sphere, six frames; `kinds` are fitted besides, `fields` are those of the file."""
    columns = range(12)
    springs = [(0, 1)] + [(2 * i + a, 2 * i + b) for i in columns[:-1] for a, b in ((0, 2), (1, 3), (0, 3), (2, 3))]
    corners = [2 * i + a for i in columns[:-1] for a in (0, 1, 3, 0, 3, 2)]
    cloth = {
        "vertPos": [{"x": float(i), "y": 0.1 * i * j, "z": float(j)} for i in columns for j in (0, 1)],
        "vertIsFixed": [i + j == 0 for i in columns for j in (0, 1)],
        "vertMass": [0.02 + 0.001 * i for i in columns for j in (0, 1)],
        "springs": [vertex for ends in springs for vertex in ends],
        "springStiffness": [30.0 + s for s in range(len(springs))],
        "triangles": corners,
        "dragCoefficient": 0.1,
        "damping": 0.1,
        "optimizationSettings": settings,
        "fit": kinds or {},
    }
    size = {"x": 0.5, "y": 0.5, "z": 0.5}
    whole = {
        "integrationMethod": 2,
        "delta": STEP,
        "optimizationIterations": 6,
        "windVel": {"x": 1.0, "y": 0.0, "z": 0.5},
        "objects": [cloth],
        "colliders": [{"type": 1, "pos": {"x": 1.0, "y": -0.1, "z": 0.0}, "scale": size}],
    }
    return load({**whole, **fields})


def simulations() -> None:
    """Move the strip by all methods, and as a reference for their errors."""
    for method in (0, 1, 2):
        scene = strip_scene(integrationMethod=method)
        energies(scene, simulate(scene))
    runge_kutta.record(build(strip_scene(), 0), STEP, 2, 1)


def gradients() -> None:
    """Differentiate its motion, both ways."""
    scene = strip_scene(kinds=FITTED_KINDS)
    objective, p = Objective(scene, simulate(scene)), parameters(scene)
    objective.cost_and_gradient(p)
    objective.tangent(p, np.ones_like(p))


def fits() -> None:
    """Fit it by each method, and to what a capture sees."""
    for method in ("auto", "gauss-newton", "l-bfgs-b"):
        estimate(strip_scene(), method=method, budget=4)
    scene = strip_scene()
    estimate(scene, degrade(record_target(scene), noise=1e-3, observed=0.5), budget=4)
    estimate(strip_scene("GG"), budget=4)


def fits_of_all_kinds() -> None:
    """Fit all that can be fitted."""
    for method in (0, 2):
        scene = strip_scene(kinds=FITTED_KINDS, fit=EVERYWHERE, integrationMethod=method)
        estimate(scene, method="gauss-newton", budget=4)


def large(very: bool) -> None:
    """All of it for a large cloth or a very large one, as shortly as possible."""
    with called(large=True, very_large=very):
        gradients()
        work = implicit.workspace(build(strip_scene(), 0))
        if work.solver.second is not None:
            serve: Any = cg_two_threads.serve  # would be called where there is a second processor only
            serve.compile(tuple(map(numba.typeof, (work.A, work.solver.cg, work.solver.second))))
        estimate(strip_scene(), method="momentum", budget=1, intervals=False)
        estimate(strip_scene(kinds=FITTED_KINDS, fit=EVERYWHERE), method="gauss-newton", budget=2, intervals=False)


SMALL_PARTS: dict[str, Callable[[], None]] = {
    "simulation": simulations,
    "gradient": gradients,
    "fits": fits,
    "fits of other kinds": fits_of_all_kinds,
}

PARTS: dict[str, Callable[[], None]] = {
    **SMALL_PARTS,
    "large cloths": partial(large, very=False),
    "very large cloths": partial(large, very=True),
}


def warm(nothing: object = None) -> None:
    """Compile what fits use, by one of a small cloth; the others find it in the cache. Takes some 20 s."""

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
