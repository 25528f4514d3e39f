"""Motions: positions over time, simulated or read from a file. A motion is data: first the record, then the checks that
its arrays fit a scene, then its file.

A motion file is an `.npz` archive: `positions` (frames, vertices, 3) m, the vertices of all objects in file order;
`times` (frames,) s; `vertex_counts` (objects,); `observed` (frames, vertices) where something was not seen; and
`weights` (vertices,) or (frames, vertices) where some positions count more in a fit than others, 0 not at all.
Positions that were not observed are NaN. An archive with `positions` alone, or a bare `.npy` array, is accepted if its
shape fits.
"""

from __future__ import annotations

import io
import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import IO, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from clothfit.base import npz
from clothfit.base.arrays import Array, Flags
from clothfit.base.errors import InvalidInput, InvalidMotion
from clothfit.base.limits import FARTHEST
from clothfit.base.messages import counted, unreadable
from clothfit.base.notebook import html_of
from clothfit.base.reading import unchanged
from clothfit.base.writing import Data, put, write_atomically
from clothfit.engine.fallbacks import NO_FALLBACKS, Fallbacks
from clothfit.engine.inputs.sampling import axes
from clothfit.formats.animation import increasing
from clothfit.formats.files import check_room, sequence_in
from clothfit.motion.correspondence import IN_ORDER, Correspondence
from clothfit.scene.scene import Scene

ARRAYS = ("positions", "times", "vertex_counts", "observed", "weights")
"""The arrays of a motion file; all others in it are ignored."""

LONGEST_REASON = 150
"""Characters of a library's reason why it cannot read a file."""


class Steps(NamedTuple):
    """What positions do not show of the steps of a simulated motion."""

    of: Array  # its positions: of others this says nothing
    work: Array  # (F,), J, of what moves, in the step that ends at each frame
    rubbed: Array | None  # (F,), J, that friction takes there; None: it is found from positions, roughly
    euler: Flags  # (G, F), of a BDF2 motion: whether that step is an implicit Euler step, for each group of cloths


@dataclass(frozen=True, eq=False)
class Motion:
    """Positions of all vertices of a scene at some times, simulated or recorded."""

    positions: Array  # (frames, vertices, 3), m, all objects in file order; NaN where not observed
    times: Array  # (frames,), s, increasing
    vertex_counts: tuple[int, ...]  # number of vertices of each object
    observed: Flags | None = None  # (frames, vertices), which positions were seen; None: all
    name: str = "motion"  # for messages
    remedies: Fallbacks = NO_FALLBACKS  # how many of its steps were solved directly, clamped, shortened or taken anew
    steps: Steps | None = None  # of a simulated motion, what positions do not show
    weights: Array | None = None  # (frames, vertices), 0 or more: how often each position counts; None: all once
    unit: float = 1.0  # of the numbers in its file, m
    path: str | None = None  # of that file; what became of its positions since, this does not say
    said: Mapping[str, Any] = field(default_factory=dict)  # fps, scale, up, handedness, as the user gave them for it
    correspondence: Correspondence = IN_ORDER  # what the points of its file are
    radii: Array = field(default_factory=lambda: np.zeros(0))  # (RAYS,), m, where its shadow alone is known

    def __repr__(self) -> str:
        frames, vertices, _ = self.positions.shape
        seen = "" if self.observed is None else f", {self.observed.mean():.3g} of them observed"
        duration = f"{self.times[0]:.4g} … {self.times[-1]:.4g} s" if frames else "no time"
        sizes = f"{counted(frames, 'frame', 'frames')} of {counted(vertices, 'vertex', 'vertices')} in m"
        return f"<Motion {self.name}: {sizes}{seen}, {duration}>"

    def _repr_html_(self) -> str:
        return html_of(self)

    def of(self, cloth: int) -> Array:
        """Positions (frames, n, 3) of one object."""
        return self.positions[:, self.part(cloth)]

    def seen(self, cloth: int | None = None) -> Flags:
        """Which positions (frames, n) of one object were observed (default: of all objects)."""
        observed = np.ones(self.positions.shape[:2], bool) if self.observed is None else self.observed
        return observed if cloth is None else observed[:, self.part(cloth)]

    def weights_of(self, cloth: int) -> Array | None:
        """How often each position (frames, n) of one object counts; None: all once."""
        return None if self.weights is None else self.weights[:, self.part(cloth)]

    def moved(self, move: Callable[[Array], Array]) -> Motion:
        """The same with all of its positions (frames, n, 3) as an affine `move` of each frame takes them."""
        points = self.correspondence
        points = points._replace(points=move(points.points)) if len(points.seen) else points
        return replace(self, positions=move(self.positions), correspondence=points)

    def part(self, cloth: int) -> slice:
        """The vertices of an object."""
        start = sum(self.vertex_counts[:cloth])
        return slice(start, start + self.vertex_counts[cloth])


def in_groups(motion: Motion, scene: Scene) -> Motion:
    """The motion with objects that are simulated together as one: all or none are."""
    whole = len(scene.groups) < len(scene.cloths)
    return replace(motion, vertex_counts=(sum(motion.vertex_counts),)) if whole else motion


def arrays_of(motion: Motion) -> dict[str, Any]:
    """The arrays of a motion with an item for each frame, by name, without those that are None."""
    arrays = {name: getattr(motion, name) for name in ("positions", "times", "observed", "weights")}
    return {name: array for name, array in arrays.items() if array is not None}


def at_frames(motion: Motion, frames: slice) -> Motion:
    """The motion at some of its frames only; its arrays are views."""
    arrays = {name: array[frames] for name, array in arrays_of(motion).items()}
    return replace(motion, correspondence=motion.correspondence.at(frames), **arrays)


def as_motion(
    scene: Scene,
    positions: Array,
    times: Array | None = None,
    observed: Flags | None = None,
    weights: Array | None = None,
) -> Motion:
    """Make a motion of `scene` from arrays.

    `positions` (frames, vertices, 3) are in m, the vertices of all objects in file order; `times` (frames,) in s
    (default: one frame per step). `observed` (frames, vertices) marks what was seen (default: everything); `weights`,
    (vertices,) or (frames, vertices), say how often a position counts (default: once). Raises InvalidMotion when an
    array does not fit the scene.
    """
    given = {"positions": positions, "times": times, "observed": observed, "weights": weights}
    return check_motion({key: np.asarray(value) for key, value in given.items() if value is not None}, scene, "motion")


def checked_motion(motion: Motion, scene: Scene) -> Motion:
    """A motion made by hand, checked as one from a file is. Raises InvalidMotion when it does not fit the scene."""
    check_counts(motion, scene)
    arrays = {key: np.asarray(array) for key, array in arrays_of(motion).items()}
    kept = {name: getattr(motion, name) for name in ("unit", "path", "said", "correspondence", "radii")}
    return replace(check_motion(arrays, scene, motion.name), **kept)


def check_motion(arrays: dict[str, NDArray[Any]], scene: Scene, name: str) -> Motion:
    """Make a Motion from the arrays of a file. Raises InvalidMotion naming the array and what would be right."""
    check_shapes(arrays, scene, name)
    counts, positions = scene.vertex_counts, np.ascontiguousarray(arrays["positions"], np.float64)
    frames, total = positions.shape[:2]
    stored = arrays.get("vertex_counts", np.array(counts)).reshape(-1)
    right = len(stored) == len(counts) and tuple(stored.tolist()) == counts
    require(right, f"{name}: vertex_counts", f"is {stored[:8].tolist()}, the scene has {list(counts)[:8]}")
    times = arrays.get("times", np.arange(frames) * scene.delta).astype(np.float64)
    require(increasing(times), f"{name}: times", "must be finite and increasing")
    observed = arrays.get("observed")
    if (unseen := unseen_in(positions)) is not None:
        observed = ~unseen if observed is None else observed & ~unseen
    if observed is not None and observed.all():
        observed = None
    check_positions(positions, observed, name)
    weights = checked_weights(arrays["weights"], (frames, total), name) if "weights" in arrays else None
    return Motion(positions, times, counts, observed, name, weights=weights)


def unseen_in(positions: Array) -> Flags | None:
    """Which positions (frames, n) are NaN, which means that they were not seen; None where none is."""
    if not any(np.isnan(frame.min(initial=0.0)) for frame in positions):  # one by one, as in `check_positions`
        return None
    return np.stack([np.isnan(frame).any(axis=1) for frame in positions])


def check_loaded(motion: object) -> None:
    """Raise InvalidInput, with how to load it, where a path is given for a motion."""
    if isinstance(motion, (str, os.PathLike)):
        path = os.fspath(motion)
        raise InvalidInput(f"motion: a path is given, {path!r}; load it: clothfit.load_motion({path!r}, scene)")


def check_counts(motion: Motion, scene: Scene) -> None:
    """Raise InvalidMotion unless the motion's objects have the scene's numbers of vertices."""
    counts = scene.vertex_counts
    if motion.vertex_counts != counts:
        own, wanted = (", ".join(map(str, some[:8])) for some in (motion.vertex_counts, counts))
        raise InvalidMotion(f"{motion.name}: its objects have {own} vertices, those of {scene.name} {wanted}")


def check_shapes(arrays: Mapping[str, NDArray[Any] | npz.Stored], scene: Scene, name: str) -> None:
    """Raise InvalidMotion, naming the array and what would be right, where types or shapes do not fit the scene."""
    require("positions" in arrays, f"{name}: positions", "is missing")
    shape, dtype, total = arrays["positions"].shape, arrays["positions"].dtype, sum(scene.vertex_counts)
    require(dtype.kind in "fiu", f"{name}: positions", f"has type {dtype}, numbers are needed")
    frames = shape[0] if shape else 0
    right = frames and shape == (frames, total, 3)
    require(right, f"{name}: positions", f"has shape {shape}, (frames, {total}, 3) fits {scene.name}")
    others: dict[str, tuple[list[tuple[int, ...]], str, str]] = {
        "times": ([(frames,)], "fiu", f"{frames} numbers, one per frame, fit; positions are (frames, vertices, 3)"),
        "observed": ([(frames, total)], "b", f"({frames}, {total}) bool fits"),
        "weights": ([(total,), (frames, total)], "fiub", f"({total},) or ({frames}, {total}) numbers fit"),
    }
    for key, (shapes, kinds, needed) in others.items():
        if (array := arrays.get(key)) is not None:
            right = array.shape in shapes and array.dtype.kind in kinds
            require(right, f"{name}: {key}", f"has shape {array.shape} and type {array.dtype}, {needed}")


def check_positions(positions: Array, observed: Flags | None, name: str) -> None:
    """Raise InvalidMotion where an observed position is not finite, or absurdly far away."""
    for frame in range(len(positions)):  # one by one: an array as large as `positions` would take as much memory again
        if np.abs(positions[frame]).max(initial=0.0) < FARTHEST:  # not of NaN
            continue
        bad = ~(np.abs(positions[frame]) < FARTHEST).all(axis=1)
        if observed is not None:
            bad &= observed[frame]
        if bad.any():
            vertex = int(np.argmax(bad))
            finite = np.isfinite(positions[frame, vertex]).all()
            wrong = f"lies {FARTHEST:g} m away or more" if finite else "is infinite"
            require(False, f"{name}: positions[{frame}, {vertex}]", f"{wrong}, though not marked as unobserved")


def checked_weights(weights: NDArray[Any], shape: tuple[int, int], name: str) -> Array:
    """Weights as (frames, vertices) from one per vertex or position. Raises InvalidMotion where one cannot be."""
    values = weights.astype(np.float64)
    wrong = ~((values >= 0) & (values < np.inf))  # NaN as well
    if wrong.any():
        place = [int(i) for i in np.argwhere(wrong)[0]]
        value = values[tuple(place)]
        raise InvalidMotion(f"{name}: weights{place} must be at least 0 and finite; {value:g} was given")
    return np.array(np.broadcast_to(values, shape))


def require(condition: object, place: str, message: str) -> None:
    """Raise InvalidMotion unless a condition holds."""
    if not condition:
        raise InvalidMotion(f"{place}: {message}")


def save_motion(motion: Motion, path_or_file: str | os.PathLike[str] | IO[bytes]) -> None:
    """Write a motion as `.npz`, whole or not at all. Raises InvalidInput when the path cannot be written."""
    if isinstance(path_or_file, (str, os.PathLike)):
        write_atomically(path_or_file, archive(motion))
    else:
        put(archive(motion), path_or_file)


def archive(motion: Motion, extra: Mapping[str, NDArray[Any]] | None = None, timed: bool = True) -> Data:
    """What writes a motion as `.npz` to a file, without copies of its arrays, and with `extra` arrays beside them.

    Not `timed`: without times, which means one frame per time step.
    """
    counts = np.array(motion.vertex_counts, np.int64)
    arrays = {"positions": motion.positions, "times": motion.times, "vertex_counts": counts, **(extra or {})}
    arrays |= arrays_of(motion)
    if not timed:
        del arrays["times"]
    return npz.archive(arrays)


def load_motion(path_or_file: str | os.PathLike[str] | IO[bytes], scene: Scene, name: str | None = None) -> Motion:
    """Read a motion of `scene` and check it. `name`: in messages (default: the file's). Raises InvalidMotion."""
    if name is None:
        name = os.path.basename(os.fspath(path_or_file)) if isinstance(path_or_file, (str, os.PathLike)) else "motion"
    with opened(path_or_file, name) as file:
        return replace(read_motion(file, scene, name), path=path_of(path_or_file))


def path_of(path_or_file: str | os.PathLike[str] | IO[bytes]) -> str | None:
    """The path of a file; None of an open one."""
    return os.fspath(path_or_file) if isinstance(path_or_file, (str, os.PathLike)) else None


@contextmanager
def opened(path_or_file: str | os.PathLike[str] | IO[bytes], name: str) -> Iterator[IO[bytes]]:
    """Open a motion file of this program to read it in the block, whose failures become an InvalidMotion."""
    try:
        if isinstance(path_or_file, (str, os.PathLike)):
            with unchanged(path_or_file) as file:
                yield file if file.seekable() else io.BytesIO(npz.content(file))
        else:  # an archive is read by seeking, which a stream cannot
            yield io.BytesIO(npz.content(path_or_file))
    except FileNotFoundError as error:
        raise InvalidMotion(f"{name}: {unreadable(error)}") from None
    except IsADirectoryError:
        raise InvalidMotion(f"{name}: is a folder; {sequence_in(path_of(path_or_file) or name)}") from None
    except InvalidInput:
        raise
    except npz.FAULTS as error:
        raise InvalidMotion(f"{name}: cannot be read as .npz or .npy ({_short(error)})") from None


def read_motion(file: IO[bytes], scene: Scene, name: str) -> Motion:
    """The motion in an open file, read once its headers fit the scene and its sizes the memory. Raises InvalidMotion.
    """
    stored = npz.stored(file, ARRAYS, "positions")
    check_shapes(stored, scene, name)
    check_room(sum(array.nbytes for array in stored.values()), name)
    return check_motion({key: array.read() for key, array in stored.items()}, scene, name)


def _short(error: BaseException) -> str:
    text = getattr(error, "strerror", None) or str(error).split("\n")[0] or type(error).__name__
    return text if len(text) <= LONGEST_REASON else f"{text[: LONGEST_REASON - 1]}…"


def in_world(motion: Motion, scene: Scene) -> Motion:
    """A motion in the scene's axes, in those of the world; the same object where these do not move."""
    return motion if scene.frame is None else motion.moved(axes(scene.frame, motion.times).world)


def in_scene(motion: Motion, scene: Scene) -> Motion:
    """The inverse of `in_world`."""
    return motion if scene.frame is None else motion.moved(axes(scene.frame, motion.times).own)


def rms(vectors: Array) -> float:
    """Root of the mean squared length of vectors (…, 3); 0 without any."""
    return float(np.sqrt((vectors**2).sum(axis=-1).mean())) if vectors.size else 0.0
