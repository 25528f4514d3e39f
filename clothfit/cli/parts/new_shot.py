"""`clothfit new SHOT`: what a file with meshes in motion gives a scene: cloths, colliders, held vertices, pins."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import click

from clothfit.base.errors import InvalidInput
from clothfit.base.messages import counted
from clothfit.cli.common.console import Console
from clothfit.cli.common.output import STREAM, Output, output_for
from clothfit.formats.axes import Reading
from clothfit.formats.registry import foreign, paths

if TYPE_CHECKING:
    from collections.abc import Sequence

    from clothfit.base.arrays import Array, Flags, Indices
    from clothfit.meshes.mesh import Mesh, Shape
    from clothfit.scene.scene import Scene

PART_OF_A_SIZE = 0.05
"""How thick an open surface becomes, as a share of the size of its mesh."""


class Solid(NamedTuple):
    """A mesh that the cloth touches."""

    name: str
    document: dict[str, Any]  # as a scene's file has the collider
    vertices: int
    frames: Array  # (F, V, 3), m; F is 0 where it keeps still
    times: Array  # (F,), s, from the cloth's first frame on
    out: Output | None  # the file of its motion
    opened: str  # what was done with a surface that was not closed

    @property
    def moves(self) -> bool:
        """Whether it moves."""
        return self.out is not None

    @property
    def sentence(self) -> str:
        """What it is, for people."""
        how = f"moves, by {self.out.name}" if self.out else "keeps still"
        done = f"; it is open, and {self.opened}" if self.opened else ""
        return f"collider {self.name}: {counted(self.vertices, 'vertex', 'vertices')}, {how}{done}"

    @property
    def summary(self) -> dict[str, Any]:
        """What --json prints of it."""
        return {"name": self.name, "vertices": self.vertices, "moves": self.moves, "closed": not self.opened}

    def write(self) -> None:
        """Write the file of its motion."""
        if self.out is not None:
            from clothfit.motion.motion import Motion, archive

            self.out.write(archive(Motion(self.frames, self.times, (self.vertices,))))


def meshes(
    path: str, cloths: Sequence[str], colliders: Sequence[str], console: Console
) -> tuple[Sequence[str], Sequence[str]]:
    """The names of the meshes that are cloth, "" for whatever there is, and of those that it touches. Raises
    InvalidInput.
    """
    from clothfit.formats.animation import chosen, listed, short

    every = [] if "*" in path else paths(foreign(path), path)
    if not every and (cloths or colliders):
        raise InvalidInput(f"{path}: has no names of meshes; leave --cloth and --collider out")
    if cloths or len(every) < 2:
        return cloths or [""], colliders
    names, place = short(every), os.path.basename(path)
    taken = {mesh for own in colliders for mesh in chosen(names, every, own, place)}
    left = [name for name in names if name not in taken]
    if len(left) == 1:
        return left, colliders
    if colliders:
        raise click.UsageError(f"--cloth says which of {listed(left)} is the cloth; add it")
    console.say(f"{place}: has {len(every)} meshes, {listed(names)}; --cloth NAME takes one, --collider NAME what it "
                "touches")
    return [""], colliders


def solid(
    path: str, name: str, convention: tuple[str | None, str | None, float | None], start: Array | None, out: Output
) -> Solid:
    """A mesh of a file as a collider; its times count from the `start`, the first of a cloth's times (F,). Raises
    InvalidInput where it is none.
    """
    import numpy as np

    from clothfit.engine.inputs.body_files import closed
    from clothfit.meshes.mesh import read_shape
    from clothfit.meshes.rigid import moves_as

    shape = read_shape(path, *convention, wanted=name)
    mesh, frames, opened = shape.mesh._replace(triangles=without_folded(shape.mesh.triangles)), shape.frames, ""
    try:
        closed(mesh)
    except InvalidInput as error:
        if "is not closed" not in str(error):
            raise InvalidInput(f"{path}: {name}: {error}") from None
        frames, mesh, opened = closed_up(frames, mesh)
        try:
            closed(mesh)
        except InvalidInput as other:
            raise InvalidInput(f"{path}: {name}: {other}") from None
    moves = len(frames) > 1 and moves_as(frames) != "still"
    count = len(mesh.positions)
    document: dict[str, Any] = {
        "type": 4, "pos": vector((0, 0, 0)), "rot": vector((0, 0, 0)), "scale": vector((1, 1, 1)),
        "mesh": {
            "vertices": [vector(each) for each in mesh.positions.tolist()],
            "triangles": mesh.triangles.reshape(-1).tolist(),
        },
    }  # fmt: skip
    if not moves or shape.times is None:
        return Solid(name, document, count, np.zeros((0, count, 3)), np.zeros(0), None, opened)
    stem = "scene" if out.path == STREAM else Path(out.path).stem
    plain = "".join(c if c.isalnum() or c in "-_" else "_" for c in name)
    place = output_for(os.path.join(out.folder, f"{stem}.{plain}.npz"), path, "", ())
    document["motion"] = {"file": os.path.basename(place.path)}
    times = shape.times - (0.0 if start is None else start[0])
    return Solid(name, document, count, frames, times, place, opened)


def without_folded(triangles: Indices) -> Indices:
    """Triangles (T, 3) but for those that lie face to face on others, as two polygons that share two sides make them.
    """
    import numpy as np

    of = np.unique(np.sort(triangles, axis=1), axis=0, return_inverse=True)[1].reshape(-1)
    a, b, c = triangles.astype(np.int64).T
    ways = np.bincount(of, np.sign((a - b) * (b - c) * (c - a)))
    found: Indices = triangles[ways[of] != 0]
    return found


def vector(xyz: Sequence[float]) -> dict[str, float]:
    """A vector as a scene's file has it."""
    return dict(zip("xyz", map(float, xyz), strict=True))


def closed_up(frames: Array, mesh: Mesh) -> tuple[Array, Mesh, str]:
    """An open surface of frames (F, n, 3) as a closed one, and what was done: its holes are closed where each is so
    narrow that a back would have more rim than the hole has area; else it gets a back behind its faces, and a rim.
    """
    import numpy as np

    from clothfit.base.eigen import connected_components
    from clothfit.formats.animation import normals_at
    from clothfit.meshes.mesh import any_sides, areas
    from clothfit.pictures.camera import normals

    triangles, count = mesh.triangles, len(mesh.positions)
    depth = PART_OF_A_SIZE * float(np.linalg.norm(np.ptp(frames[0], axis=0)))
    met = any_sides(triangles)
    uses = np.bincount(met.first, minlength=len(met.edge))[met.first]
    rim = np.flatnonzero(uses == 1)
    ways = triangles[rim // 3][:, [[0, 1], [2, 0], [1, 2]]][np.arange(len(rim)), rim % 3]  # as their triangles go
    i, j = ways.T
    edge, of = np.unique(ways, return_inverse=True)
    ends = of.reshape(ways.shape)
    label = connected_components(ends, len(edge))
    holes, own = int(label.max(initial=-1)) + 1, label[ends[:, 0]]
    middles = (frames[:, edge[label == hole]].mean(axis=1, keepdims=True) for hole in range(holes))
    lids = np.stack([j, i, count + own], 1).astype(np.int32)
    filled, length = np.concatenate([frames, *middles], axis=1), np.linalg.norm(frames[0, i] - frames[0, j], axis=1)
    area = np.bincount(own, areas(type(mesh)(filled[0], lids)))
    if (area <= depth * np.bincount(own, length)).all():
        whole = np.concatenate([triangles, lids]).astype(np.int32)
        return filled, type(mesh)(filled[0], whole), f"{counted(holes, 'hole is', 'holes are')} closed"
    up = normals(frames[0], triangles).sum(axis=0)[1]  # what is level is solid below
    back = frames - np.copysign(depth, up) * np.stack([normals_at(each, triangles) for each in frames])
    around = np.concatenate([np.stack([j, i, i + count], 1), np.stack([j, i + count, j + count], 1)])
    whole = np.concatenate([triangles, triangles[:, ::-1] + count, around]).astype(np.int32)
    every = np.concatenate([frames, back], axis=1)
    return every, type(mesh)(every[0], whole), "has got a back"


def held(shape: Shape, console: Console) -> Indices:
    """The vertices that a file marks as held, or else that move in it as if something held them."""
    import numpy as np

    from clothfit.meshes.rigid import held as groups

    if shape.pins is not None:
        return shape.pins
    found = groups(shape.frames, shape.mesh.triangles) if len(shape.frames) > 1 else []
    for each in found:
        one, many = ("moves", "move as one") if each.moves else ("keeps still", "keep still")
        count = counted(len(each.vertices), f"vertex {one}", f"vertices {many}")
        console.say(f"{count} in all frames, taken as held; --fix-side or --fix-vertices hold others")
    return np.concatenate([np.zeros(0, np.int32), *(each.vertices for each in found)])


def following(
    scene: Scene, path: str, up: str | None, handedness: str | None, scale: float | None, console: Console
) -> Scene:
    """The scene with pins that let its fixed vertices follow a motion. Raises InvalidInput."""
    from clothfit.cli.common.motions import load
    from clothfit.fit.preparation import pins_of
    from clothfit.scene.scene import with_pins

    if not any(cloth.fixed.any() for cloth in scene.cloths):
        raise InvalidInput("--pins-from: no vertex is fixed that could follow it; add --fix-side top")
    motion = load(path, scene, Reading(scale, up, handedness), console, foreign(path) is not None).motion
    items = dict(pins_of(motion, scene))
    count = sum(len(item["vertices"]) for own in items.values() for item in own)
    console.say(f"{counted(count, 'fixed vertex follows', 'fixed vertices follow')} {path}")
    return with_pins(scene, items) if items else scene


def hint(fixed: Sequence[Flags], cloths: Sequence[Any], path: str, console: Console) -> None:
    """Say where fixed vertices move in the file that the scene is made of."""
    import numpy as np

    from clothfit.meshes.rigid import tolerance

    count = 0
    for flags, cloth in zip(fixed, cloths, strict=True):
        ways = np.linalg.norm(cloth.shape.frames - cloth.shape.frames[0], axis=2).max(axis=0)
        moving = np.flatnonzero(ways > tolerance(cloth.shape.frames))
        own = moving if cloth.numbering is None else cloth.numbering[moving]
        count += int(flags[own[own >= 0]].sum())
    if count:
        what = counted(count, "held vertex moves", "held vertices move")
        console.say(f"hint: {what} in {path}; with estimate --target {path} they follow it (new --pins-from {path} "
                    "writes that into the scene)")
