"""How well a model follows the full simulation of a scene, and what both cost."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field

import numpy as np

from clothfit.base import threads
from clothfit.base.arrays import Array
from clothfit.motion.simulate import simulate
from clothfit.scene.scene import Scene
from clothfit.subspace.cost import cost
from clothfit.subspace.model import Model, Part
from clothfit.subspace.play import play

FORGOTTEN = 0.1
"""Relative error from which on points are no longer compared, but spectra and envelopes."""

TIMED = 200
"""Frames whose time is taken, at most."""


@dataclass(frozen=True)
class Judgement:
    """A motion on the subspace, compared with the full one."""

    frames: int
    rmse: float  # m
    relative_rmse: float  # to the RMS of the displacements since the start
    max_error: float  # m
    over_time: list[tuple[int, float]]  # frames, and the RMSE of the frames until then, m
    deviation: float  # of the standard deviations of the vertices over time, RMS, relative
    spectrum: float  # of the amplitudes of the vertices' spectra, relative
    us_per_frame: dict[str, float]  # state, decode, normals; µs of one thread
    full_us_per_step: float
    megabytes: float
    clamped: list[str] = field(default_factory=list)

    @property
    def forgets(self) -> bool:
        """Whether the motions are too far apart to compare points."""
        return self.relative_rmse > FORGOTTEN


def judge(model: Model, scene: Scene, frames: int) -> Judgement:
    """Compare so many frames. Raises Diverged, InvalidInput."""
    played = play(model, scene, frames)
    full = simulate(scene, frames)
    away = played.motion.positions - full.positions
    square = (away**2).sum(axis=2)
    moved = full.positions - full.positions[0]
    size = float(np.sqrt((moved**2).sum(axis=2).mean()))
    rmse = float(np.sqrt(square.mean()))
    ends = sorted({max(1, frames * k // 5) for k in range(1, 6)})
    with threads.single():
        times, whole = cost_of(model, scene, frames)
    bytes_of = sum(4 * part.basis.size + of_steps(part) for part in model.parts)
    return Judgement(
        frames=frames,
        rmse=rmse,
        relative_rmse=rmse / size if size > 0 else 0.0,
        max_error=float(np.sqrt(square.max())),
        over_time=[(end, float(np.sqrt(square[:end].mean()))) for end in ends],
        deviation=relative(deviations(played.motion.positions), deviations(full.positions)),
        spectrum=relative(amplitudes(played.motion.positions), amplitudes(full.positions)),
        us_per_frame=times,
        full_us_per_step=whole,
        megabytes=bytes_of / 1e6,
        clamped=played.clamped,
    )


def of_steps(part: Part) -> int:
    """Bytes of what steps an object."""
    return sum(each.nbytes for each in part.chosen) + (part.network.nbytes if part.network else 0)


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
    power = (np.abs(np.fft.rfft(x - x.mean(axis=0), axis=0)) ** 2).sum(axis=2).mean(axis=1)[1:]
    edges = np.unique(np.round(2.0 ** (np.arange(0, 64) / 3.0)).astype(int))
    bands = [power[a - 1 : b - 1] for a, b in itertools.pairwise(edges) if a <= len(power)]
    return np.sqrt(np.array([each.mean() for each in bands])) if bands else np.zeros(0)


def cost_of(model: Model, scene: Scene, frames: int) -> tuple[dict[str, float], float]:
    """The µs of a frame, by what they are spent on, and those of a full step, summed over the objects."""
    steps = max(1, min(frames - 1, TIMED))
    each = [cost(part, scene, c, steps) for c, part in enumerate(model.parts)]
    return {name: sum(own[name] for own, _ in each) for name in each[0][0]}, sum(full for _, full in each)
