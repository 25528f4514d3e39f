"""Reading a motion from any file: this program's own, or another program's, by its suffix.

The positions in another program's file are turned into the scene's axes and metres, get times, are cut to the frames
that the user wants and, where they are markers, assigned to vertices. `Interpretation` has all that was assumed.

The first frame is at time 0, where the scene begins: files count from their first frame, from 1, or from wherever the
animation was cut. A cloth starts at the scene's initial positions, so a frame at time 0 must be near them. Where it is
not, the file mostly has other axes or another unit than assumed, which `alignment` looks for.
"""

from __future__ import annotations

import os
import zipfile
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import product
from typing import IO, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from clothfit.base import npz
from clothfit.base.arrays import Array, Flags, Indices
from clothfit.base.errors import InvalidInput, InvalidMotion
from clothfit.base.messages import counted, metres
from clothfit.formats.animation import ASSUMED_RATE, Animation, OtherPoints, normals_at, of_scan, short
from clothfit.formats.axes import (
    AUTO,
    HANDS,
    ORDER,
    SCAN,
    SCENE,
    SURFACE,
    UPS,
    Axes,
    Reading,
    facing,
    from_scene,
    to_scene,
)
from clothfit.formats.files import check_room, name_of
from clothfit.formats.markers import METRES_PER_UNIT
from clothfit.formats.registry import NATIVE, Format, foreign, format_of, paths, read_format, suffix_of
from clothfit.motion.correspondence import MARKERS, PERMUTED, SAME, SCANNED, Bound, Correspondence, TooFar, bind
from clothfit.motion.feet import UNKNOWN, Faces
from clothfit.motion.markers import Matches, initial, matched
from clothfit.motion.motion import (
    Motion,
    at_frames,
    check_motion,
    check_positions,
    opened,
    path_of,
    read_motion,
    require,
    rms,
    unseen_in,
)
from clothfit.scene.keys import SAID
from clothfit.scene.kinds import REST
from clothfit.scene.mesh_numbering import mesh_counts, mesh_names, picks, triangles_of
from clothfit.scene.scene import Scene

DOUBTFUL_DISTANCE = 0.05
"""An RMS distance of this share of the scene's size is more than noise."""

MISLABELLED = 0.25
"""The share of the vertices that may be as far away without a word: markers that were mistaken for others."""

MOST_TRIED = 50
"""Meshes of a file that are tried."""

NEAR_BY = 0.1
"""The distance of points from vertices, relative to the scene's size, up to which they are on one surface."""

MOST_POINTS = 5000
"""Points of a frame of a scan that are used, drawn at random: more of them say little more of some hundred vertices."""

JUMPING, PAIRS = 0.5, 20
"""Squares of the ways of points from frame to frame, in those of points drawn at random, that show other points, in the
median of so many pairs of frames.
"""

SHUFFLED = "its points are others in each frame: it is taken as a scan, unless --bind says what it is"
UNORDERED = "its points are not the scene's vertices: the shape is taken as a scan, unless --bind says what it is"

MUCH_NEARER = 0.2
"""A change that leaves less than this share of the distance is worth trying."""


NPZ = Format("npz", NATIVE, "", SCENE)
"""This program's own files, whose motions need not begin at time 0."""


class Alignment(NamedTuple):
    """How well the beginning of a motion fits the scene."""

    distance: float  # root of the mean squared distance of its vertices from the scene's, m
    doubt: str | None  # a sentence, where the distance is large
    advice: str | None  # which change would fit better


@dataclass(frozen=True)
class Interpretation:
    """How a file was read."""

    file: str
    format: str
    axes: Axes
    frames: int  # of the motion
    points: int  # in the file
    seconds: float  # from the first to the last of the frames
    rate: str  # where the times come from
    notes: tuple[str, ...] = ()  # sentences on what else was assumed
    matches: Matches | None = None  # of markers
    start: Alignment | None = None  # of the first frame; None without a scene, or without a frame at time 0

    def __str__(self) -> str:
        size = f"{counted(self.frames, 'frame', 'frames')} of {counted(self.points, 'point', 'points')}"
        parts = [f"{self.file}: {self.format}, {size}, {self.rate}; {self.axes}", *self.notes]
        if self.matches is not None:
            parts.append(str(self.matches))
        return "; ".join(parts)

    @property
    def doubts(self) -> list[str]:
        """Warnings about the beginning of the motion."""
        if self.start is None or self.start.doubt is None:
            return []
        return [f"{self.file}: {'; '.join(filter(None, [self.start.doubt, self.start.advice]))}"]

    def summary(self) -> dict[str, Any]:
        """The interpretation as --json gives it."""
        start = self.start or Alignment(np.nan, None, None)
        found = {
            "file": self.file,
            "format": self.format,
            **self.axes._asdict(),
            "frames": self.frames,
            "points": self.points,
            "duration": self.seconds,
            "fps": (self.frames - 1) / self.seconds if self.seconds > 0 else None,
            "rate": self.rate,
            "notes": list(self.notes),
            "start_distance": start.distance,
            "advice": start.advice,
        }
        if self.matches is None:
            return found
        gaps = self.matches.distances
        far = {"median": float(np.median(gaps)), "largest": float(gaps.max())} if len(gaps) else {}
        return {**found, "markers": {**far, "each": [match._asdict() for match in self.matches.each]}}


@dataclass(frozen=True, eq=False)
class Loaded:
    """A motion, and what else its file holds."""

    motion: Motion
    interpretation: Interpretation
    triangles: Indices | None = None  # (T, 3), points, in the scene's axes; None: it has no faces
    names: tuple[str, ...] | None = None  # of markers, where there is no scene
    timed: bool = True  # whether the file or the user gave the times


@dataclass(frozen=True)
class Points:
    """Takes the place of the scene where there is none: the points of a file."""

    vertex_counts: tuple[int, ...]
    name: str
    delta: float = 1 / ASSUMED_RATE
    cloths: tuple[()] = field(default=())


def load(
    path_or_file: str | os.PathLike[str] | IO[bytes], scene: Scene | None, reading: Reading, name: str | None = None
) -> Loaded:
    """Read a motion of `scene`, or of whatever points there are, from a file; an open file must be `.npz` or `.npy`.

    Raises InvalidMotion, and InvalidInput when the library that reads the file is missing.
    """
    if reading.markers is not None and scene is None:
        raise InvalidInput("--map: it names vertices of a scene; add --scene")
    if not isinstance(path_or_file, (str, os.PathLike)):
        return _native(path_or_file, scene, reading, name or "motion")
    name = name_of(path_or_file) if name is None else name
    found = foreign(path_or_file)
    if found is None:
        loaded = _native(path_or_file, scene, reading, name)
    else:
        content, reading, note = _meshes(found, path_or_file, scene, reading)
        loaded = _foreign(replace(content, notes=(*note, *content.notes)), found, scene, reading, name)
    said = {key: value for key in SAID if (value := getattr(reading, key)) is not None}
    return replace(loaded, motion=replace(loaded.motion, path=path_of(path_or_file), said=said))


def _meshes(
    kind: Format, path: str | os.PathLike[str], scene: Scene | None, reading: Reading
) -> tuple[Animation, Reading, list[str]]:
    """What a file holds; of several meshes those that are asked for, those that the scene was made of, or the only one
    with as many points, with a sentence on which that is.
    """
    if reading.bind == SCAN and reading.mesh is None:
        return read_format(kind, path, scan=True), reading, []
    if reading.mesh is not None or scene is None:
        return read_format(kind, path, reading.mesh or ""), reading, []
    every = paths(kind, path) if (names := mesh_names(scene)) else []
    if names and len(every) > 1:
        with suppress(InvalidMotion):  # no meshes of these names
            return read_format(kind, path, names), replace(reading, mesh=names), [f"the cloth is its mesh {names}"]
    fault, totals = None, (sum(scene.vertex_counts), sum(mesh_counts(scene)))
    try:
        content = read_format(kind, path)
    except OtherPoints:
        if reading.bind not in (None, AUTO):
            raise
        return read_format(kind, path, scan=True), replace(reading, bind=SCAN), []
    except InvalidMotion as error:
        fault = error
    if (fault or content.positions.shape[1] not in totals) and len(every := every or paths(kind, path)) > 1:
        each = {}
        for name in short(every)[:MOST_TRIED]:
            with suppress(InvalidMotion):
                each[name] = read_format(kind, path, name)
        fitting = [name for name, own in each.items() if own.positions.shape[1] in totals]
        if len(fitting) == 1:
            note = f"the cloth is its mesh {fitting[0]}, the only one of as many points"
            return each[fitting[0]], replace(reading, mesh=fitting[0]), [note]
    if fault:
        raise fault
    return content, reading, []


def _foreign(
    read: Animation, kind: Format, scene: Scene | None, reading: Reading, name: str,
    counts: tuple[int, ...] | None = None, weights: Array | None = None,
) -> Loaded:  # fmt: skip
    """What a file has as a motion of a scene; of this program's own files with the vertices of objects, and weights.
    """
    axes = reading.axes(read.axes)
    points = read.positions.shape[1]
    times, rate, timed = _times(read, scene, reading)
    notes = list(read.notes)
    if times[0] != 0 and kind is not NPZ:
        notes.append(f"its first frame, at {times[0]:g} s, is taken as the start")
        times = times - times[0]
    positions = to_scene(read.positions, axes, own=True)
    observed = np.ones(positions.shape[:2], bool) if read.observed is None else read.observed
    if (unseen := unseen_in(positions)) is not None:
        observed = observed & ~unseen
        notes += unseen_share(unseen) if read.observed is None else []
    check_positions(positions, observed, name)
    matches, corresponds = None, Correspondence()
    if shuffled := not (read.names or kind.markers) and _is_shuffled(positions, observed, scene, reading):
        reading = replace(reading, bind=SCAN)
        notes.append(SHUFFLED)
    elif not (read.names or kind.markers) and _is_shape_alone(positions, scene, reading):
        reading = replace(reading, bind=SCAN)
        notes.append(UNORDERED)
    if scene is not None and reading.bind == SCAN:
        normals = None if read.normals is None else to_scene(read.normals, axes) / axes.scale
        if normals is None and read.triangles is not None and not shuffled:
            normals = np.stack([normals_at(each, facing(read.triangles, axes)) for each in positions])
        positions, observed, corresponds, note = _of_scan(positions, observed, normals, scene, name)
        notes.append(note)
    elif scene is not None and _are_markers(read, kind, scene, reading):
        names = read.names or tuple(str(i) for i in range(points))
        matches = matched(positions, observed, names, scene, reading.markers, name)
        notes += [matches.omission] if matches.omission else []
        of_markers, seen = positions[:, matches.columns], observed[:, matches.columns]
        positions = np.full((len(positions), sum(scene.vertex_counts), 3), np.nan)
        positions[:, matches.vertices] = np.where(seen[..., None], of_markers, np.nan)
        observed = np.zeros(positions.shape[:2], bool)
        observed[:, matches.vertices] = seen
        corresponds = Correspondence(MARKERS, len(matches.columns) / points)
    elif scene is not None:
        asked = replace(reading, bind=ORDER) if kind.markers and reading.bind is None else reading  # in their table
        made = _bound(positions, observed, scene, asked, axes, name)
        positions, observed, corresponds = made.positions, made.observed, made.correspondence
        weights = weights if weights is None or made.order is None else weights[:, made.order]
        if made.note:
            notes.append(made.note)
        elif corresponds.kind == SAME and points != positions.shape[1]:
            notes.append(f"its vertices are those of the mesh before welding to {positions.shape[1]}")
    own: Any = scene or Points(counts or (points,), name)
    _check_count(positions.shape[1], own, name)
    arrays = {"positions": positions, "times": times, "observed": observed}
    if weights is not None and corresponds.mesh is None:
        arrays["weights"] = weights
    motion = replace(check_motion(arrays, own, name), unit=axes.scale, correspondence=corresponds)
    known = Interpretation(name, kind.name, axes, 0, points, 0.0, rate, tuple(notes), matches)
    loaded = Loaded(motion, known, read.triangles, read.names if scene is None else None, timed)
    return _as_requested(loaded, scene, reading)


def _is_shuffled(points: Array, seen: Flags, scene: Scene | None, reading: Reading) -> bool:
    """Whether points (frames, m, 3) of one number are others in each frame, as far as nobody says what they are: from
    frame to frame they then jump as far as points drawn at random, 1 in the squares of both frames about their means.
    """
    if scene is None or reading.bind not in (None, AUTO) or len(points) < 2 or not len(triangles_of(scene)):
        return False
    jumps = []
    for k in np.unique(np.linspace(0, len(points) - 2, PAIRS).astype(int)):
        both = seen[k] & seen[k + 1]
        if not both.any():
            continue
        a, b = (each[both] - each[both].mean(axis=0) for each in points[k : k + 2])
        jumps.append(((a - b) ** 2).sum() / max((a**2).sum() + (b**2).sum(), 1e-300))
    return bool(jumps) and bool(np.median(jumps) > JUMPING)


def _is_shape_alone(points: Array, scene: Scene | None, reading: Reading) -> bool:
    """Whether points (1, m, 3) are of a cloth at rest, not as many as its vertices, as far as nobody says what they
    are: no frame then shows where they are on the cloth before it hangs.
    """
    if scene is None or reading.bind not in (None, AUTO) or reading.markers is not None or scene.method != REST:
        return False
    counts = (sum(scene.vertex_counts), sum(mesh_counts(scene)))
    return len(points) == 1 and points.shape[1] not in counts and len(triangles_of(scene)) > 0


def _of_scan(
    points: Array, seen: Flags, normals: Array | None, scene: Scene, name: str
) -> tuple[Array, Flags, Correspondence, str]:
    """What points (frames, m, 3), m, in no order show of a scene before they are tracked: the positions, none of them
    observed, and a note.
    """
    triangles = triangles_of(scene)
    if not len(triangles):
        raise InvalidMotion(f"{name}: is a scan, which needs faces to compare with; {scene.name} has none")
    if not seen.any():
        raise InvalidMotion(f"{name}: has no points")
    counts = seen.sum(axis=1)
    range_of = " to ".join(str(each) for each in sorted({int(counts.min()), int(counts.max())}))
    note = f"a scan of {range_of} points in a frame"
    if (most := int(counts.max())) > MOST_POINTS:
        note += f", of which {MOST_POINTS} at most are used"
    chosen, generator = np.zeros((len(points), min(most, MOST_POINTS)), np.int64), np.random.default_rng(0)
    used = np.arange(chosen.shape[1]) < counts[:, None]
    for frame, shown in enumerate(seen):
        own = np.flatnonzero(shown)
        own = own if len(own) <= MOST_POINTS else np.sort(generator.choice(own, MOST_POINTS, replace=False))
        chosen[frame, : len(own)] = own
    rows = np.arange(len(points))[:, None]
    drawn, vertices = np.where(used[..., None], points[rows, chosen], 0.0), sum(scene.vertex_counts)
    if normals is not None:
        normals = normals[rows, chosen]
        normals = normals if normals.any() else None
    faces: Indices = np.full(used.shape, UNKNOWN, np.int32)
    bound = Correspondence(SCANNED, 1.0, None, drawn, used, faces, Faces.of(triangles, vertices), normals)
    return np.full((len(points), vertices, 3), np.nan), np.zeros((len(points), vertices), bool), bound, note


def unseen_share(unseen: Flags) -> list[str]:
    """A note on positions (frames, points) that are no numbers, but for frames that are missing as a whole."""
    partly = unseen[~unseen.all(axis=1)]
    share = 100 * partly.mean() if len(partly) else 0.0
    return [f"{share:.2g} % of its positions are NaN and count as not seen"] if share else []


def _bound(points: Array, seen: Flags, scene: Scene, reading: Reading, axes: Axes, name: str) -> Bound:
    """The vertices of a scene that points (frames, m, 3), m, `seen` (frames, m), show. Raises InvalidMotion."""
    count, start, chosen, how = points.shape[1], initial(scene), None, reading.bind or AUTO
    if count == len(start):
        chosen = np.arange(count, dtype=np.int32)
    elif count == sum(mesh_counts(scene)):
        chosen = picks(scene)
    if not count or (chosen is None and how == ORDER):
        _check_count(count, scene, name)
    try:
        found = bind(points, seen, scene, start, how, chosen, name)
        if found.correspondence.kind == PERMUTED and chosen is not None and reading.handedness is None:
            # a symmetric sheet seen in a mirror has the same places: its own order says what it is
            better = advice(from_scene(points[0, chosen], axes), start, axes, DOUBTFUL_DISTANCE * size(start))
            if better and better.startswith("--"):
                return bind(points, seen, scene, start, ORDER, chosen, name)
        return found
    except TooFar as error:
        first = from_scene(points[0, seen[0]], axes)
        better = other_axes(first, start, axes, NEAR_BY * size(start)) if len(first) else None
        remedy = f"{better} would fit" if better else "export it from the mesh that the scene was made from"
        raise InvalidMotion(f"{error}; {remedy}") from None


def _as_requested(found: Loaded, scene: Scene | None, reading: Reading) -> Loaded:
    """What was read, cut to the frames that the user wants and compared with the start, with faces in the scene's axes.
    Raises InvalidMotion where there are no such frames.
    """
    motion, taken = found.motion, found.interpretation
    if reading.frames is not None:
        kept = reading.chosen()
        if not len(motion.times[kept]):
            frames = counted(len(motion.times), "frame", "frames")
            raise InvalidMotion(f"{taken.file}: has {frames}, none of which is in --frames {reading.frames}")
        motion = at_frames(motion, kept)
    start = None
    if scene is not None and motion.times[0] == 0 and motion.correspondence.mesh is not None:
        start = scan_alignment(motion.correspondence, initial(scene), taken.axes)
    elif scene is not None and motion.times[0] == 0 and scene.method != REST:
        start = alignment(motion.positions[0], motion.seen()[0], initial(scene), taken.axes)
    seconds = float(motion.times[-1] - motion.times[0])
    taken = replace(taken, frames=len(motion.times), seconds=seconds, start=start)
    triangles = None if found.triangles is None else facing(found.triangles, taken.axes)
    return replace(found, motion=motion, interpretation=taken, triangles=triangles)


def _are_markers(read: Animation, kind: Format, scene: Scene, reading: Reading) -> bool:
    """Whether the points are markers of some vertices, and not the vertices themselves, written as v0, v1, …."""
    if reading.markers is not None:
        return True
    if reading.bind == SURFACE:
        return False
    totals = (sum(scene.vertex_counts), sum(mesh_counts(scene)))
    if read.names is not None:
        return all(read.names != tuple(f"v{i}" for i in range(total)) for total in totals)
    return kind.markers and read.positions.shape[1] not in totals


def _native(
    path: str | os.PathLike[str] | IO[bytes], scene: Scene | None, reading: Reading, name: str
) -> Loaded:
    """A motion of this program, in the scene's axes unless the user says otherwise."""
    if reading.markers is not None:
        raise InvalidInput(f"--map: {name} has all vertices, in their order; leave it out")
    with opened(path, name) as file:
        if (cloud := _cloud(file, name)) is not None:
            return _scanned(cloud, scene, reading, name)
        if isinstance(path, (str, os.PathLike)) and suffix_of(path) not in ("", *NATIVE) and _is_strange(file):
            format_of(path)  # which refuses its suffix
        counts, timed, triangles, marked = _described(file)
        other = scene is None or sum(counts) not in (0, sum(scene.vertex_counts))
        own: Any = Points(counts, name) if other else scene
        motion = read_motion(file, own, name)
    own_times, seen = motion.times if timed else None, motion.observed if marked else None
    read = Animation(motion.positions, SCENE, own_times, triangles, seen)
    return _foreign(read, NPZ, scene, reading, name, counts, motion.weights)


def _scanned(cloud: dict[str, NDArray[Any]], scene: Scene | None, reading: Reading, name: str) -> Loaded:
    """The scan of a file of this program, in the scene's axes unless the user says otherwise."""
    if scene is None and reading.bind != SCAN:
        raise OtherPoints(f"{name}: is a scan, whose points are others in each frame; it is a target of estimate")
    parts = [(each, None) for each in np.split(cloud["points"].astype(float), cloud["first"][1:-1])]
    read = replace(of_scan(parts, SCENE), times=cloud.get("times"))
    if "normals" in cloud:
        normals = [(each, None) for each in np.split(cloud["normals"].astype(float), cloud["first"][1:-1])]
        read = replace(read, normals=np.nan_to_num(of_scan(normals, SCENE).positions))
    return _foreign(read, NPZ, scene, replace(reading, bind=SCAN), name)


def _cloud(file: IO[bytes], name: str) -> dict[str, NDArray[Any]] | None:
    """The arrays of a file that has a scan: `points` (N, 3), `first` (frames + 1,), where those of each frame begin,
    and perhaps `times` (frames,) and `normals` (N, 3); None of any other file. Raises InvalidMotion.
    """
    try:
        stored = npz.stored(file, ("positions", "points", "first", "times", "normals"), "positions")
        if "positions" in stored or not {"points", "first"} <= stored.keys():
            return None
        check_room(4 * sum(each.nbytes for each in stored.values()), name)
        found = {key: each.read() for key, each in stored.items()}
    except npz.FAULTS:
        return None  # which reading it as a motion explains
    finally:
        file.seek(0)
    points, first = found["points"], found["first"]
    count = len(points) if points.ndim else 0
    right = points.ndim == 2 and points.shape[1:] == (3,) and points.dtype.kind in "fiu"
    require(right, f"{name}: points", f"has shape {points.shape} and type {points.dtype}, (N, 3) numbers fit")
    whole = first.ndim == 1 and first.dtype.kind in "iu" and len(first) > 1
    ends = whole and first[0] == 0 and first[-1] == count and (np.diff(first.astype(np.int64)) >= 0).all()
    require(ends, f"{name}: first", f"must be whole numbers that rise from 0 to {count}, the number of points")
    frames = len(first) - 1
    for key, shape in (("times", (frames,)), ("normals", (count, 3))):
        if (own := found.get(key)) is not None:
            right = own.shape == shape and own.dtype.kind in "fiu"
            require(right, f"{name}: {key}", f"has shape {own.shape} and type {own.dtype}, {shape} numbers fit")
    return found


def _is_strange(file: IO[bytes]) -> bool:
    """Whether the content of a file is neither an archive with positions nor an array: to name what is missing in it as
    an archive would blame the wrong thing.
    """
    try:
        if file.read(len(npz.NPY_MAGIC)) == npz.NPY_MAGIC:
            return False
        with zipfile.ZipFile(file) as archive:
            return "positions.npy" not in archive.namelist()
    except (OSError, ValueError, zipfile.BadZipFile):
        return True
    finally:
        file.seek(0)


def _described(file: IO[bytes]) -> tuple[tuple[int, ...], bool, Indices | None, bool]:
    """What a file says before the scene is known: the points of each object, whether it has times, its faces (T, 3),
    None without any, and whether it marks what was observed. Nothing of a damaged one, as reading it raises the error.
    """
    try:
        stored = npz.stored(file, ("positions", "times", "vertex_counts", "triangles", "observed"), "positions")
        total = stored["positions"].shape[1]
        counts, triangles = _whole(stored.get("vertex_counts"), 1), _whole(stored.get("triangles"), 2)
    except (*npz.FAULTS, KeyError, IndexError, TypeError):
        return (0,), True, None, True
    finally:
        file.seek(0)
    fits = counts is not None and (counts >= 0).all() and counts.sum() == total
    if triangles is not None and not (triangles.shape[1] == 3 and ((triangles >= 0) & (triangles < total)).all()):
        triangles = None
    own = tuple(counts.tolist()) if counts is not None and fits else (total,)
    faces = None if triangles is None else triangles.astype(np.int32)
    return own, "times" in stored, faces, "observed" in stored


def _whole(stored: npz.Stored | None, dimensions: int) -> NDArray[Any] | None:
    """An array of whole numbers; None for other types or another number of dimensions."""
    if stored is None or stored.dtype.kind not in "iu" or len(stored.shape) != dimensions:
        return None
    return stored.read()


def _times(read: Animation, scene: Scene | None, reading: Reading) -> tuple[Array, str, bool]:
    """The times (frames,) of all frames, s, where they come from, and whether the file or the user gave them."""
    places: Array = read.spacing * np.arange(len(read.positions), dtype=np.float64)
    if reading.fps is not None:
        return places / reading.fps, f"{reading.fps:g} frames a second as given", True
    if read.times is not None:
        return read.times, f"{_rate(read.times)} by its own times", True
    if scene is not None:
        return scene.delta * np.arange(len(places), dtype=np.float64), _per_step(scene), False
    return places / ASSUMED_RATE, f"{ASSUMED_RATE:g} frames a second assumed", False


def _per_step(scene: Scene | None) -> str:
    step = "" if scene is None else f" of {scene.delta:.4g} s"
    return f"one frame per time step{step}, as it has no times"


def _rate(times: Array) -> str:
    if len(times) < 2:
        return "one time"
    return f"{(len(times) - 1) / (times[-1] - times[0]):.6g} frames a second"


def _check_count(points: int, scene: Scene | Points, name: str) -> None:
    if points == 0:
        raise InvalidMotion(f"{name}: has no points")
    if points != sum(scene.vertex_counts):
        raise InvalidMotion(
            f"{name}: has {points} vertices, {scene.name} has {sum(scene.vertex_counts)}; a motion needs all vertices "
            "of all objects, in their order: export it from the mesh that the scene was made from"
        )


def alignment(points: Array, seen: Flags, start: Array, axes: Axes) -> Alignment:
    """Compare the observed vertices, `seen` (n,), of a frame (n, 3), m, with the start (n, 3) of the scene.

    `axes`: those assumed for the file.
    """
    points, start = points[seen], start[seen]
    if not len(points):
        return Alignment(np.nan, None, None)
    distance = rms(points - start)
    most = float(np.quantile(np.linalg.norm(points - start, axis=1), 1.0 - MISLABELLED))
    if min(distance, most) <= DOUBTFUL_DISTANCE * size(start):
        return Alignment(distance, None, None)
    doubt = f"its first frame is {metres(distance)} (RMS) away from where the scene begins"
    bar = min(MUCH_NEARER * distance, NEAR_BY * size(start))  # a cloth that shrinks to a point is nearer, but not there
    return Alignment(distance, doubt, advice(from_scene(points, axes), start, axes, bar))


def scan_alignment(scan: Correspondence, start: Array, axes: Axes) -> Alignment:
    """Compare the first frame of a scan with the start (n, 3) of the scene, by the nearer points."""
    assert scan.mesh is not None
    points = scan.points[0, scan.seen[0]]
    if not len(points):
        return Alignment(np.nan, None, None)
    distance = float(np.median(np.abs(scan.feet(start, 0).gaps)))
    if distance <= DOUBTFUL_DISTANCE * size(start):
        return Alignment(distance, None, None)
    doubt = f"its first frame is {metres(distance)} (in the median) away from where the scene begins"
    better = other_axes(from_scene(points, axes), start, axes, NEAR_BY * size(start))
    return Alignment(distance, doubt, f"{better} would fit" if better else "a fit places the mesh there")


def advice(points: Array, start: Array, axes: Axes, bar: float) -> str | None:
    """Which change would bring points (n, 3), as in the file, nearer to the start than `bar`, m."""
    scales = sorted({*METRES_PER_UNIT.values(), axes.scale})
    others = [Axes(up, hand, scale) for up, hand, scale in product(UPS, HANDS, scales)]
    best = min(others, key=lambda each: (rms(to_scene(points, each) - start), differences(each, axes)))
    if rms(to_scene(points, best) - start) < bar:
        return f"{options(best, axes)} would fit"
    now = to_scene(points, axes)
    shift = (now - start).mean(axis=0)
    if rms(now - shift - start) < bar:
        x, y, z = np.round(shift, 3) + 0.0  # no −0
        return f"it is moved by ({x:.3g}, {y:.3g}, {z:.3g}) m"
    for each in sorted(others, key=lambda each: differences(each, axes)):
        if unordered(to_scene(points, each), start) < bar:
            return f"{f'with {options(each, axes)} ' if each != axes else ''}its vertices would fit in another order"
    return None


def other_axes(points: Array, start: Array, axes: Axes, bar: float) -> str | None:
    """Which axes or unit would bring points (m, 3), as in the file, within `bar`, m, of the start (n, 3)."""
    others = [Axes(up, hand, scale) for up, hand, scale in product(UPS, HANDS, sorted({*METRES_PER_UNIT.values()}))]
    best = min(others, key=lambda each: (unordered(to_scene(points, each), start), differences(each, axes)))
    return options(best, axes) if unordered(to_scene(points, best), start) < bar else None


def unordered(points: Array, others: Array) -> float:
    """The RMS distance from each of two sets of points (n, 3) to the nearest points of the other, m, the larger one."""
    from scipy.spatial import KDTree

    pairs = ((points, others), (others, points))
    return max(float(np.sqrt(np.mean(KDTree(b).query(a)[0] ** 2))) for a, b in pairs)


def options(axes: Axes, other: Axes) -> str:
    """The command's options for axes that differ from `other`."""
    changed = [name for name in axes._fields if getattr(axes, name) != getattr(other, name)]
    return " ".join(f"--{name} {getattr(axes, name)}" for name in changed)


def differences(axes: Axes, other: Axes) -> int:
    """In how many of the three fields they differ."""
    return sum(a != b for a, b in zip(axes, other, strict=True))


def size(points: Array) -> float:
    """Diagonal of the box around points (n, 3), m."""
    return float(np.linalg.norm(np.ptp(points, axis=0)))
