"""How well a model follows the full simulation of a scene, and what both cost.

Costs of a frame of a subspace and of a full step are in µs of one thread.

Whether points can be compared at all is told by how much a small difference at the start grows in the full simulation.
The start is moved by noise, a `PART` of the RMS of the motion's displacements, and simulated once more. Where the two
full motions part by a hundred times as much, one on a basis that leaves out such a part is another motion as well,
however exact its steps: then its spectrum and its envelope tell whether it is one of the same kind.

How far the points of a motion on a basis must be off is shown by the full simulation itself, where it goes on from what
the basis holds of a state (`floor`): no steps on the basis, by physics or by a network, know more of it.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass, field
from time import process_time

import numpy as np

from clothfit.base import threads
from clothfit.base.arrays import Array
from clothfit.engine.inputs.tables import later
from clothfit.engine.rollout import rollout
from clothfit.engine.system import IMPLICIT, System, build
from clothfit.motion.energy import Energy, energies
from clothfit.motion.motion import Motion, in_world, rms
from clothfit.motion.simulate import simulate
from clothfit.optimise.balances import active_rows
from clothfit.scene.scene import Scene
from clothfit.subspace import translation
from clothfit.subspace.frames import Decoder, angles
from clothfit.subspace.model import Model, Part
from clothfit.subspace.play import Played, play, rolled, stepper

FORGOTTEN = 0.1
"""Relative error from which on points are no longer compared, but spectra and envelopes."""

GROWN = 10.0
"""Growth of a small difference at the start from which on it is said."""

TIMED = 200
"""Frames whose time is taken, at most."""


NORMALS_SEEN = 60
"""Frames whose normals are compared, at most."""


@dataclass(frozen=True)
class Validation:
    """A motion on the subspace, compared with the full one."""

    frames: int
    rmse: float  # m
    relative_rmse: float  # to the RMS of the displacements since the start
    max_error: float  # m
    over_time: list[tuple[int, float]]  # frames, and the RMSE of the frames until then, m
    drift: float  # m, RMS distance of the mean shapes of the last fifth of the frames
    energy: float  # RMS difference of the stored energy, relative to the largest that the full motion stores
    energy_gain: float  # largest energy beyond that at the start and the work of the wind, relative to the same
    deviation: float  # of the standard deviations of the vertices over time, RMS, relative
    spectrum: float  # of the amplitudes of the vertices' spectra, relative
    growth: float  # of a small difference at the start, in the full simulation (`growth`)
    normals: dict[str, float]  # mean angle to those of the full motion, degrees: of faces, by regression
    us_per_frame: dict[str, float]  # state, decode, normals, and normals by regression; µs of one thread
    full_us_per_step: float
    megabytes: float
    clamped: list[str] = field(default_factory=list)
    floor: float = 0.0  # relative RMSE that no steps on the basis can avoid; 0: not sought

    @property
    def us_whole(self) -> float:
        """The µs of a frame."""
        return whole(self.us_per_frame)

    @property
    def forgets(self) -> bool:
        """Whether the motions are too far apart to compare points."""
        return self.relative_rmse > FORGOTTEN

    @property
    def chaotic(self) -> bool:
        """Whether a small difference at the start has become a large one."""
        return self.growth > GROWN

    @property
    def parted(self) -> str:
        """Why points are not compared."""
        if self.chaotic:
            return f"a small difference at the start grows {self.growth:.2g}-fold in the full simulation"
        return "the two motions have parted"


@dataclass(frozen=True, eq=False)
class Compared:
    """Both motions, in the scene's axes, and what the comparison says."""

    model: Model
    scene: Scene
    own: Motion
    full: Motion
    coordinates: list[Array]  # of each object, (frames, r)
    energies: tuple[Energy, Energy]  # of the motion on the subspace, of the full one
    found: Validation

    def projected(self, c: int) -> Array:
        """The coordinates (frames, r) nearest to the full motion of object c, by mass."""
        system = build(self.scene, c, steps=len(self.full.times) - 1)
        x, basis = in_world(self.full, self.scene).of(c), self.model.parts[c].basis
        return translation.coordinates(x - system.x0, system, translation.projection(basis, system))


def compare(model: Model, scene: Scene, frames: int) -> Compared:
    """Compare so many frames. Raises Diverged, InvalidInput."""
    played = play(model, scene, frames)
    own, full = played.motion, simulate(scene, frames)
    both = energies(scene, own), energies(scene, full)
    away, moved = own.positions - full.positions, full.positions - full.positions[0]
    square, size, rmse, stored = (away**2).sum(axis=2), rms(moved), rms(away), both[1].scale or 1.0
    steps = max(1, min(frames - 1, TIMED))
    with threads.single():
        costs = [cost(part, scene, c, steps) for c, part in enumerate(model.parts)]
    bytes_of = sum(4 * part.basis.size + sum(each.nbytes for each in part.chosen) for part in model.parts)
    bytes_of += sum(part.network.nbytes for part in model.parts if part.network)
    ends = sorted({max(1, frames * k // 5) for k in range(1, 6)})
    floors, held = [0.0], in_world(full, scene)
    for c, part in enumerate(model.parts if size > 0.0 and rmse > SOUGHT * size else ()):
        system = build(scene, c, steps=frames - 1)
        floors.append(floor(part.basis, system, held.of(c) - system.x0, scene.tolerance))
    judgement = Validation(
        frames=frames,
        rmse=rmse,
        relative_rmse=rmse / size if size > 0 else 0.0,
        max_error=float(np.sqrt(square.max())),
        drift=float(np.sqrt((away[-max(1, frames // 5) :].mean(axis=0) ** 2).sum(axis=1).mean())),
        energy=float(np.sqrt(((both[0].total - both[1].total) ** 2).mean())) / stored,
        energy_gain=both[0].gain[0] / stored,
        over_time=[(end, float(np.sqrt(square[:end].mean()))) for end in ends],
        deviation=relative(*(np.sqrt(each.positions.var(axis=0).sum(axis=1)) for each in (own, full))),
        spectrum=relative(*(bands(each.positions)[1] for each in (own, full))),
        growth=growth(scene, full),
        normals=normals(model, scene, played, full),
        us_per_frame={name: sum(each[name] for each, _ in costs) for name in costs[0][0]},
        full_us_per_step=sum(step for _, step in costs),
        megabytes=bytes_of / 1e6,
        clamped=played.clamped,
        floor=max(floors),
    )
    return Compared(model, scene, own, full, played.coordinates, both, judgement)


def normals(model: Model, scene: Scene, played: Played, full: Motion) -> dict[str, float]:
    """The mean angles, degrees, between the normals of a motion on the subspace and of the full one: those of its faces
    and, where all objects have it, by regression.
    """
    frames = np.unique(np.linspace(0, len(full.times) - 1, NORMALS_SEEN).astype(int))
    own, straight = in_world(played.motion, scene), in_world(full, scene)
    gaps: dict[str, list[Array]] = {"faces": [], "regression": []}
    for c, part in enumerate(model.parts):
        cloth = scene.cloths[c]
        decoder = Decoder(cloth.positions, part.basis, cloth.triangles, part.normals)
        for t in frames:
            true, made = (decoder.normals(x.of(c)[[t]].astype(np.float32)).copy() for x in (straight, own))
            gaps["faces"].append(angles(made, true))
            if part.normals is not None:
                gaps["regression"].append(angles(decoder.predicted(played.coordinates[c][[t]]), true))
    found = {name: np.concatenate(each, axis=1) for name, each in gaps.items() if len(each) == len(gaps["faces"])}
    return {name: float(np.nanmean(each)) for name, each in found.items() if np.isfinite(each).any()}


def relative(a: Array, b: Array) -> float:
    """|a − b| / |b|."""
    size = float(np.linalg.norm(b))
    return float(np.linalg.norm(a - b)) / size if size > 0 else 0.0




def bands(x: Array) -> tuple[Array, Array]:
    """The amplitudes of the frequencies of a motion (frames, n, 3), RMS over the vertices, each of them the mean of its
    neighbours' in a band of a third of an octave; before them the middles of the bands, periods in the motion.
    """
    power = (np.abs(np.fft.rfft(x - x.mean(axis=0), axis=0)) ** 2).sum(axis=2).mean(axis=1)[1:]
    edges = np.unique(np.round(2.0 ** (np.arange(0, 64) / 3.0)).astype(int))
    pairs = [(a, b) for a, b in itertools.pairwise(edges) if a <= len(power)]
    middle = np.sqrt(np.array([a * (b - 1.0) for a, b in pairs]))
    return middle, np.sqrt(np.array([power[a - 1 : b - 1].mean() for a, b in pairs]))


def cost(part: Part, scene: Scene, cloth: int, steps: int) -> tuple[dict[str, float], float]:
    """The µs of a frame, the mean over so many from the start of a scene: of state, decoding, normals, and normals by
    regression where there is one; and of a full step.
    """
    system = build(scene, cloth, steps=steps)
    own = stepper(part, system, steps, {})
    decoder = Decoder(system.x0, part.basis, scene.cloths[cloth].triangles, part.normals)
    decoder.normals(decoder.positions(np.zeros((1, own.r))))  # compiled, and its memory touched
    rolled(own, 1, scene.name)
    begin = process_time()
    q = rolled(own, steps, scene.name)
    spent = {"state": process_time() - begin, "decode": 0.0, "normals": 0.0}
    if part.normals is not None:
        decoder.predicted(q[:1])
        spent["regression"] = 0.0
    for frame in q[1:, None]:
        times = [process_time()]
        x = decoder.positions(frame)
        times.append(process_time())
        decoder.normals(x)
        times.append(process_time())
        if part.normals is not None:
            decoder.predicted(frame)
        for name, time in zip(list(spent)[1:], np.diff([*times, process_time()]), strict=False):
            spent[name] += float(time)
    rollout(system, min(steps, 2), scene.tolerance)  # the same of full steps
    begin = process_time()
    rollout(system, steps, scene.tolerance)
    full = process_time() - begin
    return {name: 1e6 / steps * time for name, time in spent.items()}, 1e6 / steps * full


def whole(us: Mapping[str, float]) -> float:
    """The µs of a frame: its state, positions and the cheaper of the normals."""
    return us["state"] + us["decode"] + min(us[name] for name in ("normals", "regression") if name in us)


PART = 1e-3
"""Small against the motion, and large against what the solver leaves."""


SOUGHT = 0.02
"""Relative error of a motion on a basis from which on its floor is found."""

GOES_ON = (1 / 24, 1 / 12, 1 / 6, 1 / 3)
"""Parts of a motion after which the full simulation goes on from what a basis holds."""


def growth(scene: Scene, full: Motion, seed: int = 0) -> float:
    """The RMS distance of the two motions in the last fifth of the frames, relative to that at the start; the largest
    over the objects. 0 where nothing moves.
    """
    held, frames, found = in_world(full, scene), len(full.times), [0.0]
    for c in range(len(scene.cloths)):
        system, x = build(scene, c, steps=max(1, frames - 1)), held.of(c)
        size = PART * rms(x - x[0])
        if size == 0.0:
            continue
        noise = np.random.default_rng(seed).standard_normal(system.x0.shape) * size / np.sqrt(3.0)
        noise[~system.vertex.free] = 0.0
        moved, good = rollout(system._replace(x0=system.x0 + noise), frames - 1, scene.tolerance)
        away = np.sqrt(((moved.x[: good + 1] - x[: good + 1]) ** 2).sum(axis=2).mean(axis=1))
        found.append(float(np.sqrt((away[-max(1, frames // 5) :] ** 2).mean())) / rms(noise[None]))
    return max(found)


def floor(basis: Array, system: System, x: Array, tolerance: float) -> float:
    """How far the full simulation is from a motion of displacements x (frames, n, 3), m, if it goes on from what a
    basis (n, 3, r) holds of one of its states: RMS over all frames, those before it without error, relative to that of
    the motion. The largest for some states.
    """
    flat, inputs, frames, found = basis.reshape(-1, basis.shape[2]), system.inputs, len(x), [0.0]
    q = translation.coordinates(x, system, translation.projection(basis, system))
    free = system.vertex.free[:, None]
    for k in sorted({max(1, int(part * frames)) for part in GOES_ON} & set(range(1, frames - 1))):
        away = x[k - 1 : k + 1] - translation.shift(inputs, 2, k - 1)  # of fixed vertices and pins nothing is left out
        held = np.where(free, (q[k - 1 : k + 1] @ flat.T).reshape(away.shape), away) + (x[k - 1 : k + 1] - away)
        v = np.ascontiguousarray((held[1] - held[0]) / system.h)
        begun = system._replace(x0=system.x0 + held[1], v0=v, inputs=later(inputs, k))
        made, good = rollout(begun, frames - 1 - k, tolerance, load_before(system, k, system.x0 + held, v))
        error = made.x[: good + 1] - system.x0 - x[k : k + good + 1]
        found.append(float(np.sqrt((error**2).sum(axis=2).mean(axis=1).sum() / frames)))
    return max(found) / max(rms(x), 1e-300)


def load_before(system: System, k: int, x: Array, v: Array) -> float | Array:
    """What presses vertices at colliders in the step before step k, an Euler step between the positions x (2, n, 3)."""
    colliders = system.colliders
    if colliders is None or not len(colliders.rows) or system.method < IMPLICIT:
        return -1.0
    before = system._replace(inputs=later(system.inputs, k - 1))
    return np.asarray(active_rows(before, colliders, x, np.stack([v] * 2), np.ones(1, bool))[1][1])


def at_best(found: float) -> str:
    """A `floor` in words."""
    text = "the full simulation itself is so far off where it goes on from what the vectors hold"
    return f"at best {100 * found:.2g} %: {text}"
