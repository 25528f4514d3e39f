"""Recording motions of a scene under many inputs, in parallel, each of them straight to disk.

DATA is an `.npz` archive: `recorded`, JSON with the folder, the ranges and the inputs of each episode; `scene`, the
text of the scene; and for each episode e and object c the displacements `x{e}.{c}` (frames, n, 3), m, in single
precision, with `good{e}.{c}` (frames,): which frames a plain step led to. A motion that diverges ends there; frames
after steps that were shortened or clamped (`engine.step.guard`) do not count.

Motions of other programs become such data with their frames at the times of the steps, and the inputs that moved them.
A motion whose frames are at other times is read between them by cubic splines. Frames in which not all vertices are
seen do not count. What pushes or moves the cloth beside the scene's own wind, pins and obstacles must be named as
inputs, as a network learns what follows from what it is told.
"""

from __future__ import annotations

import io
import json
import os
import tempfile
import zipfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from clothfit.base import interrupts, npz
from clothfit.base.arrays import Array, Flags
from clothfit.base.errors import InvalidInput
from clothfit.base.memory import check_memory
from clothfit.base.writing import write_atomically
from clothfit.engine.system import build
from clothfit.engine.tape import Tape
from clothfit.motion.markers import initial
from clothfit.motion.motion import Motion
from clothfit.motion.times import frame_places
from clothfit.scene.scene import Scene, dumps, load
from clothfit.subspace import inputs
from clothfit.subspace.inputs import Episode, Ranges, varied

SOLVE_TOLERANCE = 1e-6
"""Of the linear systems, relative: what they miss a subspace would learn."""

ALONE = 3_000_000
"""Vertices × steps below which the motions are computed in this process: others take longer to start."""


@dataclass(frozen=True)
class Recorded:
    """What became of the episodes."""

    frames: int  # that are kept
    left_out: int  # that are not: guarded, or after a motion diverged
    diverged: int  # episodes


def record(
    scene: Scene, own: Sequence[Episode], ranges: Ranges, steps: int, path: str | os.PathLike[str],
    report: Callable[[int, int], None] = lambda done, count: None,
) -> Recorded:  # fmt: skip
    """Simulate the episodes, `steps` steps each, and write them to a file."""
    from clothfit.base.threads import usable_cores

    text, folder, cores = dumps(scene), os.path.abspath(scene.folder), min(usable_cores(), len(own))
    lengths = []
    with archived(scene, own, ranges, steps, path) as place:
        jobs = ((text, folder, each, steps, f"{place}/{e}") for e, each in enumerate(own))
        if cores == 1 or sum(scene.vertex_counts) * steps * len(own) < ALONE:
            done = (motions(*job) for job in jobs)
        else:
            import joblib

            parallel = joblib.Parallel(n_jobs=cores, return_as="generator")
            done = parallel(joblib.delayed(motions)(*job) for job in jobs)
        for each in done:
            lengths.append(each)
            report(len(lengths), len(own))
            interrupts.check()
    frames = sum(steps + 1 for each in lengths for _ in each)
    kept = sum(good for each in lengths for good, _ in each)
    ended = sum(any(length < steps + 1 for _, length in each) for each in lengths)
    return Recorded(kept, frames - kept, ended)


@contextmanager
def archived(
    scene: Scene, own: Sequence[Episode], ranges: Ranges, steps: int, path: str | os.PathLike[str]
) -> Iterator[str]:
    """Gives a folder for the arrays of all episodes (`keep`), which become the archive at the end of the block."""
    about = {"folder": os.path.abspath(scene.folder), "steps": steps, "ranges": asdict(ranges),
             "episodes": [asdict(each) for each in own]}  # fmt: skip
    with tempfile.TemporaryDirectory(prefix="clothfit-", dir=os.path.dirname(os.path.abspath(path))) as place:
        yield place

        def pack(file: IO[bytes]) -> None:
            with zipfile.ZipFile(file, "w", zipfile.ZIP_STORED, allowZip64=True) as archive:
                for name, content in (("recorded", json.dumps(about).encode()), ("scene", dumps(scene))):
                    stream = io.BytesIO()
                    np.save(stream, np.frombuffer(content, np.uint8))
                    archive.writestr(f"{name}.npy", stream.getvalue())
                for one in sorted(Path(place).iterdir()):
                    e, c, kind, _ = one.name.split(".")
                    archive.write(one, f"{kind}{e}.{c}.npy")

        write_atomically(path, pack)


def keep(stem: str, cloth: int, x: NDArray[np.float32], good: Flags) -> None:
    """Write the arrays of one object in the episode with a `stem`, its number in the folder."""
    np.save(f"{stem}.{cloth}.x.npy", x)
    np.save(f"{stem}.{cloth}.good.npy", good)


def motions(text: bytes, folder: str, own: Episode, steps: int, stem: str) -> list[tuple[int, int]]:
    """Simulate one episode, and write the arrays of its objects to files; of each object the good frames, and all."""
    scene = varied(load(io.BytesIO(text), folder=folder), own)
    found = []
    for c in range(len(scene.cloths)):
        system = build(scene, c, steps=steps)
        tape = Tape(system, steps, SOLVE_TOLERANCE)
        x, good = np.zeros((steps + 1, len(system.x0), 3), np.float32), np.ones(steps + 1, bool)
        end = 1
        for part in tape.forward():
            x[part.first : part.first + part.steps + 1] = part.x - system.x0
            good[part.first + 1 : part.first + 1 + part.steps] = (part.theta == 1.0) & ~part.clamped & ~part.predicted
            end = part.first + part.steps + 1
        end = end if tape.fault is None else tape.good + 1
        keep(stem, c, x[:end], good[:end])
        found.append((int(good[:end].sum()), end))
    return found


class Data:
    """A file of recorded motions."""

    def __init__(self, path: str | os.PathLike[str]) -> None:
        """Raises InvalidInput where it is none."""
        self.path = path
        try:
            text, about = (self.array(name).tobytes() for name in ("scene", "recorded"))
            self.record: dict[str, Any] = json.loads(about)
            items = self.record["episodes"]
            self.episodes = [Episode(tuple(each["items"]), float(each["pace"])) for each in items]
            self.ranges, self.steps = Ranges(**self.record["ranges"]), int(self.record["steps"])
        except (ValueError, KeyError, TypeError, AttributeError):
            raise InvalidInput(f"{os.fspath(path)}: it is no data of clothfit subspace record") from None
        self.scene = load(io.BytesIO(text), folder=self.record["folder"])

    def array(self, name: str) -> Any:
        """One of its arrays. Raises InvalidInput."""
        try:
            with open(self.path, "rb") as file:
                found = npz.stored(file, (name,), "")
                return found[name].read()
        except (*npz.FAULTS, KeyError) as error:
            why = getattr(error, "strerror", None) or str(error)
            raise InvalidInput(f"{os.fspath(self.path)}: it is no data of clothfit subspace record: {why}") from None

    def motion(self, episode: int, cloth: int) -> tuple[Array, Flags]:
        """The displacements (frames, n, 3), m, and which frames are good."""
        return self.array(f"x{episode}.{cloth}").astype(float), self.array(f"good{episode}.{cloth}").astype(bool)

    def scene_of(self, episode: int) -> Scene:
        """The scene with the inputs of an episode."""
        return varied(self.scene, self.episodes[episode])


FEWEST = 4
"""Frames of a motion at least: a cubic spline needs as many."""

ROW = 1.5
"""Times the distance of the frames, up to which two of them are frames in a row."""


def episode(scene: Scene, path: str | None) -> Episode:
    """The episode of a motion with the inputs of a file, or with the scene's own. Raises InvalidInput."""
    if path is None:
        return Episode(())
    items = []
    for each in inputs.load(path):
        own = dict(each)
        if isinstance(own.get("file"), str):
            own["file"] = os.path.abspath(Path(path).parent / own["file"])
        items.append(own)
    inputs.applied(scene, items, name=path)
    return Episode(tuple(items))


def collect(scene: Scene, given: Sequence[tuple[Motion, Episode]], path: str | os.PathLike[str]) -> Recorded:
    """Write motions of a scene, each with its episode, as data. Raises InvalidInput."""
    if scene.frame:
        raise InvalidInput(f"{scene.name}: frame: motions of other programs need axes that stand still")
    found = [stepped(scene, motion, own) for motion, own in given]
    steps = max(len(x) for x, _ in found) - 1
    ends = np.cumsum([0, *scene.vertex_counts])
    with archived(scene, [own for _, own in given], Ranges(0.0, 0.0, 1.0), steps, path) as place:
        for e, (x, good) in enumerate(found):
            for c, (first, end) in enumerate(pairwise(ends)):
                keep(f"{place}/{e}", c, x[:, first:end], good)
    kept = sum(int(good.sum()) for _, good in found)
    return Recorded(kept, sum(len(good) for _, good in found) - kept, 0)


def stepped(scene: Scene, motion: Motion, own: Episode) -> tuple[NDArray[np.float32], Flags]:
    """The displacements (frames, n, 3), m, of a motion at the times of the steps, single precision, and which frames
    are seen whole; fixed vertices are where the scene has them.
    """
    whole = np.asarray(motion.seen().all(axis=1))
    if whole.sum() < FEWEST:
        raise InvalidInput(f"{motion.name}: {whole.sum()} frames show all vertices; at least {FEWEST} are needed")
    step, fraction = frame_places(motion, scene.delta)
    count = int(step[whole][-1]) + 1
    check_memory(count, motion.positions.shape[1], 0)
    x, good = at_steps(motion.positions[whole], motion.times[whole] / scene.delta, (step + fraction)[whole], count)
    still = [cloth.fixed.copy() for cloth in scene.cloths]
    for fixed, cloth in zip(still, varied(scene, own).cloths, strict=True):
        for pin in cloth.pins:
            fixed[pin.vertices] = False  # keys move them
    start = initial(scene)
    return (np.where(np.concatenate(still)[:, None], start, x) - start).astype(np.float32), good


def at_steps(x: Array, places: Array, snapped: Array, count: int) -> tuple[Array, Flags]:
    """Positions (count, N, 3) after so many steps, and which of these have a frame, or lie between two in a row, from
    frames (F, N, 3) at `places`, in steps, which are whole numbers where they are `snapped` (`motion.times`).
    """
    steps = np.arange(count)
    after = np.clip(np.searchsorted(snapped, steps), 1, len(snapped) - 1)
    after = np.where(snapped[after - 1] == steps, after - 1, after)
    there = snapped[after] == steps
    if there.all():
        return x[after], there
    from scipy.interpolate import CubicSpline

    near = snapped[after] - snapped[after - 1] < ROW * np.median(np.diff(snapped))
    return np.asarray(CubicSpline(places, x, axis=0)(steps)), there | (near & (steps >= snapped[0]))
