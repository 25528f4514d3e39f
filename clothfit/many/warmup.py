"""Compile everything that commands can need ahead of time: for images, continuous integration, or a quick first run.

Compiled code depends only on the types of arguments, so a strip of a few vertices, put through every method once,
compiles the same code as a cloth of thousands. Large cloths are solved with other types; to compile for these, the
strip is treated as large.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any, NamedTuple

import numba
import numpy as np
from numba.core import event
from numba.core.registry import CPUDispatcher, cpu_target

from clothfit.engine.solve import cg_multigrid, sparse
from clothfit.engine.step import implicit
from clothfit.engine.system import build
from clothfit.fit.estimate import estimate, record_target
from clothfit.fit.options import FitOptions
from clothfit.kernels import cache as kernel_cache
from clothfit.kernels import raster
from clothfit.kernels.cache import KernelCache
from clothfit.motion.degrade import degrade
from clothfit.motion.energy import energies
from clothfit.motion.simulate import simulate
from clothfit.objective.objective import Objective
from clothfit.scene.fit_vector import parameters
from clothfit.scene.scene import Scene, load

STEP = 0.001  # s, short enough for explicit steps
# to fit as well as masses and stiffnesses
FITTED_KINDS = {"damping": "G", "dragCoefficient": "G", "vertVel": "L", "springRestLength": "L"}
EVERYWHERE = {"windVel": True, "gravity": True}
# as fast as contacts need that begin within a step, into a sphere of 2 m
FALL: dict[str, Any] = {
    "delta": 0.05,
    "windVel": {"x": 0.0, "y": 0.0, "z": 0.0},
    "gravity": {"x": 0.0, "y": -1000.0, "z": 0.0},
    "colliders": [{"type": 1, "pos": {"x": 5.0, "y": -3.0, "z": 0.0}, "scale": {"x": 4.0, "y": 4.0, "z": 4.0}}],
}
LARGE_FROM, NEVER = 10, 2**31  # vertices


class Part(NamedTuple):
    """One part of the program and what compiling it took."""

    name: str
    compiled: int  # functions, counted once for each combination of types
    seconds: float


def warm_up(report: Callable[[Part], None] = lambda part: None, small: bool = False) -> list[Part]:
    """Compile what is not compiled yet, part by part; `report` is called after each part.

    With `small` only the code for cloths that are not large is compiled. A record beside the compiled code lists its
    files; while all of them exist nothing is done.
    """
    processor = cpu_target.target_context.codegen().magic_tuple()
    record = kernel_cache.file_name("warmup", small, processor, kernel_cache.of_package())
    recorded = kernel_cache.load(record)
    if recorded is not None and all(kernel_cache.load(name) for name in recorded[1].decode().split()):
        KernelCache.used = recorded[0]
        return [Part(name, 0, 0.0) for name in (SMALL_PARTS if small else PARTS)]
    parts = use_everything(report, small)
    if not KernelCache.failed:
        with suppress(OSError):  # without the record it is done again the next time
            KernelCache.used = kernel_cache.save(record, "\n".join(sorted(KernelCache.names)).encode())
    return parts


def use_everything(report: Callable[[Part], None], small: bool) -> list[Part]:
    """Run everything that is compiled, part by part; on a second processor `kernels.helper` compiles along."""
    parts = []
    for name in SMALL_PARTS if small else PARTS:
        parts.append(used(name))
        report(parts[-1])
    return parts


def used(name: str) -> Part:
    """Run a part."""
    began = time.perf_counter()
    with compilations() as found:
        PARTS[name]()
    return Part(name, len(found), time.perf_counter() - began)


@contextmanager
def compilations() -> Iterator[list[str]]:
    """After the block, the names of the functions that were compiled within it."""
    found: list[str] = []
    with event.install_recorder("numba:compile") as recorder:
        yield found
    for _, each in recorder.buffer:
        dispatcher = each.data["dispatcher"]
        if each.is_start and isinstance(dispatcher, CPUDispatcher):  # not callbacks, which every process compiles anew
            found.append(f"{dispatcher.py_func.__module__}.{dispatcher.py_func.__name__}")


@contextmanager
def called(large: bool) -> Iterator[None]:
    """Within the block, treat every cloth as large, or none."""
    before = sparse.MULTIGRID_FROM
    sparse.MULTIGRID_FROM = LARGE_FROM if large else NEVER
    try:
        yield
    finally:
        sparse.MULTIGRID_FROM = before


def strip_scene(settings: str = "LL", kinds: dict[str, str] | None = None, **fields: Any) -> Scene:
    """A strip in the wind over a sphere, six frames; `kinds` are fitted as well, `fields` replace those of the file."""
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
    """Simulate the strip with all integrators, also where it falls on a sphere."""
    for method in (0, 1, 2, 3):
        scene = strip_scene(integrationMethod=method)
        energies(scene, simulate(scene))
    simulate(strip_scene(**FALL))


def gradients() -> None:
    """Differentiate its motion, backward and forward."""
    for method in (0, 2, 3):
        scene = strip_scene(kinds=FITTED_KINDS, integrationMethod=method)
        objective, p = Objective(scene, simulate(scene)), parameters(scene)
        objective.cost_and_gradient(p)
        objective.tangent(p, np.ones_like(p))


def fits() -> None:
    """Fit it by each method, also to a noisy target that is observed in part."""
    for method in ("auto", "gauss-newton", "l-bfgs-b"):
        estimate(strip_scene(), method=method, options=FitOptions(max_evaluations=4))
    scene = strip_scene()
    estimate(scene, degrade(record_target(scene), noise=1e-3, observed=0.5), options=FitOptions(max_evaluations=4))
    estimate(strip_scene("GG"), options=FitOptions(max_evaluations=4))


def fits_of_all_kinds() -> None:
    """Fit every kind of parameter."""
    for method in (0, 2, 3):
        scene = strip_scene(kinds=FITTED_KINDS, fit=EVERYWHERE, integrationMethod=method)
        estimate(scene, method="gauss-newton", options=FitOptions(max_evaluations=4))


def pictures() -> None:
    """Draw a triangle and a sphere."""
    places = np.array([[0.0, 0.0, 1.0], [4.0, 0.0, 1.0], [0.0, 4.0, 1.0]])
    image, depth = np.ones((4, 4, 3)), np.ones((4, 4))
    light, colour = np.array([0.0, 0.0, -1.0]), np.ones(3)
    raster.fill(places, places, np.array([[0, 1, 2]], np.int32), colour[None], light, 1.0, image, depth)
    raster.fill_sphere(places[0], 1.0, 1.0, colour, light, image, depth)


def worlds() -> None:
    """Simulate, differentiate and fit the strip beside a wall: the code is that of all that moves or touches."""
    wall = {"type": 3, "pos": {"x": 1.0, "y": -9.0, "z": 0.0}, "scale": {"x": 1.0, "y": 1.0, "z": 1.0}}
    scene = strip_scene(colliders=[wall])
    objective, p = Objective(scene, simulate(scene)), parameters(scene)
    objective.cost_and_gradient(p)
    objective.tangent(p, np.ones_like(p))
    estimate(scene, method="gauss-newton", options=FitOptions(max_evaluations=2))


def large() -> None:
    """Differentiate and fit the strip as a large cloth, as briefly as possible."""
    with called(large=True):
        gradients()
        work = implicit.workspace(build(strip_scene(), 0))
        kinds = map(numba.typeof, (work.A, work.solver.cg, *work.solver.large))
        serve: Any = cg_multigrid.serve  # otherwise called only where there is a second processor
        serve.outer.compile(tuple(kinds))
        estimate(strip_scene(), method="momentum", options=FitOptions(max_evaluations=1, intervals=False))
        scene = strip_scene(kinds=FITTED_KINDS, fit=EVERYWHERE)
        estimate(scene, method="gauss-newton", options=FitOptions(max_evaluations=2, intervals=False))


SMALL_PARTS: dict[str, Callable[[], None]] = {
    "simulation": simulations,
    "gradient": gradients,
    "fits": fits,
    "fits of other kinds": fits_of_all_kinds,
    "pictures": pictures,
    "scenes that move or touch": worlds,
}

PARTS: dict[str, Callable[[], None]] = {**SMALL_PARTS, "large cloths": large}


def warm(nothing: object = None) -> None:
    """Compile what fits use by fitting the strip twice; other processes find it in the cache. Takes some 20 s."""
    scene = strip_scene(delta=0.02)
    estimate(scene, start=0.5, options=FitOptions(max_evaluations=5))
    estimate(scene, start=0.5, method="l-bfgs-b", options=FitOptions(max_evaluations=2, intervals=False))
