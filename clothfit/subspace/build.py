"""From recorded motions to a model: the basis, the cubature, and how well both follow a motion that neither saw.

How well a recorded motion is followed decides the basis and the cubature.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clothfit.base.arrays import Array, Flags
from clothfit.base.errors import InvalidInput
from clothfit.engine.system import System
from clothfit.engine.system import build as build_system
from clothfit.motion.motion import rms
from clothfit.scene.scene import dumps
from clothfit.subspace import basis as bases
from clothfit.subspace import frames, translation
from clothfit.subspace.model import Model, Part
from clothfit.subspace.physics import cubature
from clothfit.subspace.physics.march import roll
from clothfit.subspace.physics.samples import Reduced, check_reducible, decode
from clothfit.subspace.recording import SOLVE_TOLERANCE, Data
from clothfit.subspace.validation import FORGOTTEN, SOUGHT, bands, cost, floor, relative, whole

DEFAULT_SIZE, LARGEST_SIZE = 64, 512

CUBATURES = (0.08, 0.04, 0.02, 0.01)
"""Errors of cubatures, relative to the sum over all elements; the coarsest that is good enough is taken."""

CHANGES = 1.0
"""Weight of the changes from frame to frame in the basis of a cloth that flutters."""

TIMED = 60
"""Frames whose time is taken."""

STATES = 160
"""Of the recorded motions, for the cubature."""


@dataclass(frozen=True)
class Options:
    """What to build."""

    size: int | None = None  # vectors; None: as the error asks, else DEFAULT_SIZE
    error: float | None = None  # m, that the basis may leave out
    cubature: tuple[float, ...] = CUBATURES  # errors, the largest first; none: all elements
    modes: int | None = None  # vibration modes among the vectors; None: one in sixteen
    normals: bool = False  # whether the model gives normals by regression
    half: bool = False  # whether bases have half precision
    seed: int = 0

    def check(self) -> None:
        """Raise InvalidInput where a number is impossible."""
        if self.size is not None and not 1 <= self.size <= LARGEST_SIZE:
            raise InvalidInput(f"--basis must be between 1 and {LARGEST_SIZE}; {self.size} was given")
        if self.error is not None and not (np.isfinite(self.error) and self.error > 0):
            raise InvalidInput(f"--error must be above 0; {self.error:g} m was given")
        for error in self.cubature:
            if not 0 < error < 1:
                raise InvalidInput(f"--cubature must be above 0 and below 1; {error:g} was given")


@dataclass
class Report:
    """What was found of one object."""

    vectors: int
    left_out: dict[int, float]  # m, by number of vectors
    elements: dict[str, tuple[int, int]]  # of each kind, evaluated and there
    errors: dict[str, float]  # of the cubature, of each kind
    us_per_frame: dict[str, float] = field(default_factory=dict)  # state, decode, normals; µs
    full_us_per_step: float = 0.0
    whole: Fitness | None = None  # with all elements, of the episode that was held out
    sampled: Fitness | None = None  # with the cubature
    floor: float = 0.0  # relative error that no steps on the basis can avoid; 0: not sought

    @property
    def pays(self) -> bool:
        """Whether a frame takes less time than a full step."""
        return whole(self.us_per_frame) < self.full_us_per_step

    def judged(self, found: Fitness, part: Part, system: System, x: Array) -> None:
        """Keep how a recorded motion (frames, n, 3) is followed, with its floor where that matters."""
        self.sampled = found
        self.floor = floor(part.basis, system, x, SOLVE_TOLERANCE) if found.relative > SOUGHT else 0.0


def build(
    data: Data, options: Options, report: Callable[[str], None] = lambda text: None, held_out: int = 1
) -> tuple[Model, list[Report]]:
    """The model of all objects. The last episodes, `held_out` of them, only judge it."""
    options.check()
    count = len(data.episodes)
    kept = list(range(count - held_out if count > held_out else count))
    beside = [e for e in range(count) if e not in kept]
    scene = data.scene
    parts, reports = [], []
    limits: dict[str, list[list[float]]] = {}
    for c in range(len(scene.cloths)):
        check_reducible(build_system(scene, c, steps=1))
        part, found = of_object(data, c, kept, options, limits, report)
        for e in beside:
            x, _ = data.motion(e, c)
            system = build_system(data.scene_of(e), c, steps=data.steps)
            found.whole = fitness(Reduced(system, part.basis), x)
            found.judged(fitness(Reduced(system, part.basis, part.chosen), x), part, system, x)
        found.us_per_frame, found.full_us_per_step = cost(part, data.scene_of(kept[0]), c, min(data.steps, TIMED))
        parts.append(part)
        reports.append(found)
    folder = os.path.abspath(scene.folder)
    built = {"objects": [summary(each) for each in reports], "seed": options.seed}
    return Model(dumps(scene), folder, tuple(parts), limits, built), reports


def of_object(
    data: Data, c: int, kept: Sequence[int], options: Options, limits: dict[str, list[list[float]]],
    report: Callable[[str], None],
) -> tuple[Part, Report]:  # fmt: skip
    """The subspace of one object."""
    systems = [build_system(data.scene_of(e), c, steps=data.steps) for e in kept]
    for system in systems:
        widen(limits, system)
    report("decomposing the motions")
    found, U = basis_of(data, c, systems, kept, options)
    runs = runs_on(U, systems)
    x, _ = data.motion(kept[-1], c)
    if options.modes is None and (plain := fitness(runs[-1], x)).forgets:
        report("decomposing what the motions change, which flutter or are not followed")
        others, other = basis_of(data, c, systems, kept, options, CHANGES)
        if fitness(runs_on(other, systems[-1:])[0], x).better_than(plain):
            found, U, runs = others, other, runs_on(other, systems)
    envelope, samples = seen(data, c, kept, runs, options.seed)
    table = {k: float(found.left_out[k]) for k in bases.SIZES if k < len(found.left_out)}
    chosen = runs[0].chosen
    there, errors = chosen.counts, dict.fromkeys(chosen.counts, 0.0)
    if options.cubature and samples:
        report("choosing the elements of the cubature")
        choices = cubature.find(runs, samples, options.cubature, options.seed)
        chosen, errors = coarsest(runs[-1], U, choices, x)
    elements = {name: (used, there[name]) for name, used in chosen.counts.items()}
    normals = normals_of(data, c, kept, runs) if options.normals else None
    part = Part(U, chosen, envelope, normals, half=options.half)
    return part, Report(U.shape[2], table, elements, errors)


def basis_of(
    data: Data, c: int, systems: Sequence[System], kept: Sequence[int], options: Options, changes: float = 0.0
) -> tuple[bases.Decomposition, Array]:
    """A decomposition of the motions and a basis (n, 3, r) of it; with `changes`, no vibration modes."""
    own = systems[0]
    found = bases.decompose(data, c, systems, options.size or LARGEST_SIZE, kept, changes)
    size, modes = options.size or DEFAULT_SIZE, 0 if changes else options.modes
    if options.size is None and options.error is not None:
        good = np.flatnonzero(found.left_out <= options.error)
        size = max(1, int(good[0]) if len(good) else len(found.left_out) - 1)
    last = bases.frames_of(data, c, kept[0], own, 1 << 30)[-1] + own.x0
    precision = np.float16 if options.half else np.float32
    return found, bases.enriched(found, own, size, last, modes).astype(precision).astype(float)


def runs_on(basis: Array, systems: Sequence[System]) -> list[Reduced]:
    """The reduced cloth with all its elements under the inputs of each motion."""
    first = Reduced(systems[0], basis)
    return [first.under(system) for system in systems]


def on_basis(
    data: Data, c: int, kept: Sequence[int], runs: Sequence[Reduced]
) -> Iterator[tuple[Reduced, Array, Flags, Array]]:
    """Of each recorded motion its run, the displacements (frames, n, 3), m, which frames are good, and the coordinates
    (frames, r).
    """
    onto = translation.projection(runs[0].basis, runs[0].system)
    for run, episode in zip(runs, kept, strict=True):
        x, good = data.motion(episode, c)
        yield run, x, good, translation.coordinates(x, run.system, onto)


def normals_of(data: Data, c: int, kept: Sequence[int], runs: Sequence[Reduced]) -> NDArray[np.float32]:
    """The regression of the normals of the recorded motions on their coordinates."""
    each = max(2, frames.MOST_FRAMES // len(kept))

    def states() -> Iterator[tuple[Array, Array]]:
        for run, x, good, q in on_basis(data, c, kept, runs):
            chosen = np.flatnonzero(good)[:: max(1, -(-int(good.sum()) // each))]
            yield q[chosen], x[chosen] + run.system.x0

    return frames.regression(states(), data.scene.cloths[c].triangles)


def seen(
    data: Data, c: int, kept: Sequence[int], runs: Sequence[Reduced], seed: int
) -> tuple[Array, list[cubature.Sample]]:
    """The least and largest coordinates (2, r) of the recorded motions, and some of their steps."""
    ends, found, rng = [], [], np.random.default_rng([seed, c])
    for number, (run, x, good, q) in enumerate(on_basis(data, c, kept, runs)):
        ends += [q[good].min(axis=0), q[good].max(axis=0)]
        v = np.diff(q, axis=0) / run.system.h
        steps = [t for t in range(1, len(x) - 1) if good[t - 1 : t + 2].all()]
        some = rng.permutation(steps)[: -(-STATES // len(kept))]
        found += [cubature.Sample(number, int(t), q[t], v[t - 1], v[t]) for t in sorted(some)]
    return np.stack([np.min(ends, axis=0), np.max(ends, axis=0)]), found


def widen(limits: dict[str, list[list[float]]], system: System) -> None:
    """Widen the range of the recorded inputs by those of one motion."""
    tables, inputs = {"start": system.v0}, system.inputs
    if inputs is not None:
        moved = inputs.path - system.x0[inputs.pins] if inputs.path.size else inputs.path
        tables |= {"wind": inputs.wind, "gravity": inputs.gravity, "pins": moved}
    for name, table in tables.items():
        if table.size:
            rows = table.reshape(-1, 3)
            low, high = rows.min(axis=0), rows.max(axis=0)
            before = limits.get(name, [low, high])
            limits[name] = [np.minimum(before[0], low).tolist(), np.maximum(before[1], high).tolist()]


def summary(report: Report) -> dict[str, Any]:
    """A report as JSON holds it."""
    made: dict[str, Any] = {"vectors": report.vectors, "elements": report.elements, "errors": report.errors}
    made |= {"us_per_frame": report.us_per_frame, "full_us_per_step": report.full_us_per_step}
    made["floor"] = report.floor
    made["left_out"] = {str(k): value for k, value in report.left_out.items()}
    for name in ("whole", "sampled"):
        own = getattr(report, name)
        made[name] = None if own is None else {"rmse": own.rmse, "relative_rmse": own.relative}
    return made


AS_GOOD = 1.25
"""How far, relative to that with all elements, a recorded motion with few may be from the full one."""

GOOD = 1e-3
"""Of the RMS of a motion: what is good enough."""


@dataclass(frozen=True)
class Fitness:
    """How a reduced motion compares with the full one, over all frames of one episode."""

    rmse: float  # m
    relative: float  # to the RMS of the motion's displacements
    spectrum: float = 0.0  # of the amplitudes of the vertices' spectra, relative

    @property
    def forgets(self) -> bool:
        """Whether points mean nothing, but spectra."""
        return not self.relative <= FORGOTTEN

    def better_than(self, other: Fitness) -> bool:
        """Whether this is nearer to the recorded motion: by points, or where neither follows these, by spectrum."""
        if self.forgets and other.forgets:
            return self.spectrum < other.spectrum
        return self.relative < other.relative


def fitness(own: Reduced | Array, x: Array) -> Fitness:
    """How a motion on the subspace, or its displacements (frames, n, 3), compare with the recorded ones, x."""
    made = decode(own.system, own.basis, roll(own, len(x) - 1)) - own.system.x0 if isinstance(own, Reduced) else own
    rmse, size = rms(made - x), rms(x)
    spectrum = relative(bands(made)[1], bands(x)[1]) if np.isfinite(rmse) else np.inf
    return Fitness(rmse, rmse / size if size > 0 else 0.0, spectrum)


def coarsest(own: Reduced, basis: Array, choices: Sequence[cubature.Found], x: Array) -> cubature.Found:
    """The first of some choices of elements with which a recorded motion (frames, n, 3) is followed nearly as well as
    with all of them, else the last; what `own` leaves out with all of them no cubature mends.
    """
    if len(choices) == 1:
        return choices[0]
    whole = fitness(own, x)
    for each in choices[:-1]:
        found = fitness(Reduced(own.system, basis, each.selection), x)
        if whole.forgets and found.spectrum <= AS_GOOD * whole.spectrum:
            return each
        if found.relative <= max(GOOD, AS_GOOD * whole.relative) and not whole.forgets:
            return each
    return choices[-1]
