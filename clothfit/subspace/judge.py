"""How well a model follows the full simulation of a scene, and what both cost.

Costs of a frame of a subspace and of a full step are in µs of one thread.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass, field
from time import process_time

import numpy as np

from clothfit.base import threads
from clothfit.base.arrays import Array
from clothfit.engine.rollout import rollout
from clothfit.engine.system import build
from clothfit.motion.energy import Energy, energies
from clothfit.motion.motion import Motion, in_world
from clothfit.motion.simulate import simulate
from clothfit.scene.scene import Scene
from clothfit.subspace import carrier
from clothfit.subspace.frames import Decoder, angles
from clothfit.subspace.model import Model, Part
from clothfit.subspace.play import Played, play, rolled, stepper
from clothfit.subspace.sensitivity import SOUGHT, floor_of, growth

FORGOTTEN = 0.1
"""Relative error from which on points are no longer compared, but spectra and envelopes."""

GROWN = 10.0
"""Growth of a small difference at the start from which on it is said."""

TIMED = 200
"""Frames whose time is taken, at most."""


NORMALS_SEEN = 60
"""Frames whose normals are compared, at most."""


@dataclass(frozen=True)
class Judgement:
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
    growth: float  # of a small difference at the start, in the full simulation (`sensitivity`)
    normals: dict[str, float]  # mean angle to those of the full motion, degrees: of faces, by regression
    us_per_frame: dict[str, float]  # state, decode, normals, and normals by regression; µs of one thread
    full_us_per_step: float
    megabytes: float
    clamped: list[str] = field(default_factory=list)
    floor: float = 0.0  # relative RMSE that no steps on the basis can avoid (`sensitivity`); 0: not sought

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
    found: Judgement

    def projected(self, c: int) -> Array:
        """The coordinates (frames, r) nearest to the full motion of object c, by mass."""
        system = build(self.scene, c, steps=len(self.full.times) - 1)
        x, basis = in_world(self.full, self.scene).of(c), self.model.parts[c].basis
        return carrier.coordinates(x - system.x0, system, carrier.projection(basis, system))


def judge(model: Model, scene: Scene, frames: int) -> Judgement:
    """Compare so many frames. Raises Diverged, InvalidInput."""
    return compare(model, scene, frames).found


def compare(model: Model, scene: Scene, frames: int) -> Compared:
    """The same, with the motions."""
    played = play(model, scene, frames)
    full = simulate(scene, frames)
    both = energies(scene, played.motion), energies(scene, full)
    found = judged(model, scene, played, full, both)
    return Compared(model, scene, played.motion, full, played.coordinates, both, found)


def judged(model: Model, scene: Scene, played: Played, full: Motion, both: tuple[Energy, Energy]) -> Judgement:
    """What two motions and their energies say."""
    frames = len(full.times)
    away = played.motion.positions - full.positions
    square = (away**2).sum(axis=2)
    moved = full.positions - full.positions[0]
    size = float(np.sqrt((moved**2).sum(axis=2).mean()))
    rmse = float(np.sqrt(square.mean()))
    ends = sorted({max(1, frames * k // 5) for k in range(1, 6)})
    far = size > 0.0 and rmse > SOUGHT * size
    with threads.single():
        times, step = cost_of(model, scene, frames)
    bytes_of = sum(4 * part.basis.size + of_steps(part) for part in model.parts)
    return Judgement(
        frames=frames,
        rmse=rmse,
        relative_rmse=rmse / size if size > 0 else 0.0,
        max_error=float(np.sqrt(square.max())),
        drift=float(np.sqrt((away[-max(1, frames // 5) :].mean(axis=0) ** 2).sum(axis=1).mean())),
        energy=float(np.sqrt(((both[0].total - both[1].total) ** 2).mean())) / (both[1].scale or 1.0),
        energy_gain=both[0].gain[0] / (both[1].scale or 1.0),
        over_time=[(end, float(np.sqrt(square[:end].mean()))) for end in ends],
        deviation=relative(deviations(played.motion.positions), deviations(full.positions)),
        spectrum=relative(amplitudes(played.motion.positions), amplitudes(full.positions)),
        growth=growth(scene, full),
        normals=normals(model, scene, played, full),
        us_per_frame=times,
        full_us_per_step=step,
        megabytes=bytes_of / 1e6,
        clamped=played.clamped,
        floor=floor_of(scene, full, [part.basis for part in model.parts]) if far else 0.0,
    )


def of_steps(part: Part) -> int:
    """Bytes of what steps an object."""
    return sum(each.nbytes for each in part.chosen) + (part.network.nbytes if part.network else 0)


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
            true, made = (decoder.normals(x.of(c)[t].astype(np.float32)).copy() for x in (straight, own))
            gaps["faces"].append(angles(made, true))
            if part.normals is not None:
                gaps["regression"].append(angles(decoder.predicted(played.coordinates[c][t]), true))
    found = {name: np.concatenate(each) for name, each in gaps.items() if len(each) == len(gaps["faces"])}
    return {name: float(np.nanmean(each)) for name, each in found.items() if np.isfinite(each).any()}


def relative(a: Array, b: Array) -> float:
    """|a − b| / |b|."""
    size = float(np.linalg.norm(b))
    return float(np.linalg.norm(a - b)) / size if size > 0 else 0.0


def deviations(x: Array) -> Array:
    """The standard deviation of each vertex over time, (n,), m."""
    return np.asarray(np.sqrt(x.var(axis=0).sum(axis=1)))


def amplitudes(x: Array) -> Array:
    """The amplitudes of the frequencies of a motion (frames, n, 3), RMS over the vertices, each of them the mean of its
    neighbours' in a band of a third of an octave.
    """
    return bands(x)[1]


def bands(x: Array) -> tuple[Array, Array]:
    """The same, after the middles of the bands, periods in the motion."""
    power = (np.abs(np.fft.rfft(x - x.mean(axis=0), axis=0)) ** 2).sum(axis=2).mean(axis=1)[1:]
    edges = np.unique(np.round(2.0 ** (np.arange(0, 64) / 3.0)).astype(int))
    pairs = [(a, b) for a, b in itertools.pairwise(edges) if a <= len(power)]
    middle = np.sqrt(np.array([a * (b - 1.0) for a, b in pairs]))
    return middle, np.sqrt(np.array([power[a - 1 : b - 1].mean() for a, b in pairs]))


def cost_of(model: Model, scene: Scene, frames: int) -> tuple[dict[str, float], float]:
    """The µs of a frame, by what they are spent on, and those of a full step, summed over the objects."""
    steps = max(1, min(frames - 1, TIMED))
    each = [cost(part, scene, c, steps) for c, part in enumerate(model.parts)]
    return {name: sum(own[name] for own, _ in each) for name in each[0][0]}, sum(full for _, full in each)


def cost(part: Part, scene: Scene, cloth: int, steps: int) -> tuple[dict[str, float], float]:
    """The mean over so many frames from the start of a scene: of state, decoding, normals, and normals
    by regression where there is one; and of a full step.
    """
    system = build(scene, cloth, steps=steps)
    own = stepper(part, system, steps, {})
    decoder = Decoder(system.x0, part.basis, scene.cloths[cloth].triangles, part.normals)
    decoder.normals(decoder.positions(np.zeros(own.r)))
    rolled(own, 1, scene.name)
    begin = process_time()
    q = rolled(own, steps, scene.name)
    spent = np.array([process_time() - begin, 0.0, 0.0])
    for each in q[1:]:
        times = [process_time()]
        x = decoder.positions(each)
        times.append(process_time())
        decoder.normals(x)
        spent[1:] += np.diff([*times, process_time()])
    rollout(system, min(steps, 2), scene.tolerance)  # compiled, and its memory touched
    begin = process_time()
    rollout(system, steps, scene.tolerance)
    whole = process_time() - begin
    names = ("state", "decode", "normals")
    found = dict(zip(names, (1e6 / steps * spent).tolist(), strict=True))
    return found | regression(decoder, np.zeros(own.r), steps), 1e6 / steps * whole


def whole(us: Mapping[str, float]) -> float:
    """The µs of a frame: its state, positions and the cheaper of the normals."""
    cheaper = min(us[name] for name in ("normals", "regression") if name in us)
    return us["state"] + us["decode"] + cheaper


def regression(decoder: Decoder, q: Array, steps: int) -> dict[str, float]:
    """The time of normals by regression; nothing where there is none."""
    if decoder.regression is None:
        return {}
    decoder.predicted(q)
    begin = process_time()
    for _ in range(steps):
        decoder.predicted(q)
    return {"regression": 1e6 / steps * (process_time() - begin)}
