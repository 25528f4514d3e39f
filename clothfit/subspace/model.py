"""MODEL: a file with all that playing a subspace needs, an `.npz` archive.

`subspace`, JSON: version, method, folder of the scene's paths, range of the recorded inputs, and what was measured
when it was built; `scene`, the text of the scene; and for each object c its `basis{c}` (n, 3, r), single precision,
and the elements that its steps evaluate with their weights: `springs{c}`, `spring_weight{c}`, `faces{c}`,
`face_weight{c}`, `vertices{c}`, `vertex_weight{c}`; `envelope{c}` (2, r), the least and largest coordinates of the
recorded motions; and where it was asked for `normals{c}` (n, 3, 1 + r), single precision (`frames`). Where that was
asked for, bases and normals have half precision. A network has none of the elements, and the arrays of
`network.weights`. For players that read no scenes there are the arrays of `InitialState`, which this program ignores.
"""

from __future__ import annotations

import io
import json
import os
from dataclasses import dataclass, field
from typing import IO, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from clothfit.base import npz
from clothfit.base.arrays import Array, Indices
from clothfit.base.errors import InvalidInput
from clothfit.base.writing import Data, write_atomically
from clothfit.engine.system import build
from clothfit.scene.scene import Scene, load
from clothfit.subspace import translation
from clothfit.subspace.network import weights
from clothfit.subspace.network.weights import Network
from clothfit.subspace.physics.samples import Selection

VERSION = 1
HEAD = "subspace"
"""Name of the archive's first array."""

PHYSICS, NETWORK = "physics", "network"
METHODS = (PHYSICS, NETWORK)


@dataclass(frozen=True, eq=False)
class Part:
    """The subspace of one object."""

    basis: Array  # (n, 3, r)
    chosen: Selection
    envelope: Array  # (2, r)
    normals: NDArray[np.float32] | None = None  # (n, 3, 1 + r), of the regression; None: not asked for
    network: Network | None = None  # what steps it in place of physics
    half: bool = False  # whether basis and normals are stored in half precision, and have no more digits

    @property
    def precision(self) -> type[np.floating[Any]]:
        """The type in which basis and normals are stored."""
        return np.float16 if self.half else np.float32


@dataclass(frozen=True, eq=False)
class Model:
    """The subspaces of all objects of a scene."""

    text: bytes  # of the scene
    folder: str  # that paths in it are relative to
    parts: tuple[Part, ...]
    limits: dict[str, list[list[float]]]  # least and largest (3,) of the recorded motions: of what is added to "wind"
    # and "gravity", of the way of the "pins", m, and of the velocities at the "start", m/s
    built: dict[str, Any] = field(default_factory=dict)  # what was measured then
    method: str = PHYSICS

    def scene(self) -> Scene:
        """The scene that it was built of."""
        return load(io.BytesIO(self.text), folder=self.folder)


def arrays(model: Model) -> dict[str, Any]:
    """What the file holds."""
    about = {"version": VERSION, "method": model.method, "folder": model.folder, "limits": model.limits,
             "built": model.built, "objects": len(model.parts)}  # fmt: skip
    if model.method == NETWORK:
        about["networks"] = [weights.described(part.network) for part in model.parts if part.network]
    found: dict[str, Any] = {HEAD: np.frombuffer(json.dumps(about).encode(), np.uint8)}  # first: it tells the file
    found["scene"] = np.frombuffer(model.text, np.uint8)
    scene = model.scene()
    for c, part in enumerate(model.parts):
        found[f"basis{c}"] = part.basis.astype(part.precision)
        found |= {f"{name}{c}": array for name, array in initial_state(scene, c, part.basis)._asdict().items()}
        found[f"envelope{c}"] = part.envelope
        for name, value in part.chosen._asdict().items():
            found[f"{name}{c}"] = value
        if part.normals is not None:
            found[f"normals{c}"] = part.normals.astype(part.precision)
        if part.network is not None:
            found |= weights.arrays(part.network, c)
    return found


def encoded(model: Model) -> Data:
    """What writes the file."""
    return npz.archive(arrays(model))


def save(model: Model, path: str | os.PathLike[str]) -> None:
    """Write a model. Raises InvalidInput where the file cannot be written."""
    write_atomically(path, encoded(model))


def load_model(path: str | os.PathLike[str]) -> Model:
    """Read a model. Raises InvalidInput where it is none, or damaged."""
    name = os.fspath(path)
    try:
        with open(path, "rb") as file:
            head = npz.stored(file, ("scene", HEAD), "")
            text, about = head["scene"].read().tobytes(), json.loads(head[HEAD].read().tobytes())
            if about["version"] != VERSION or about["method"] not in METHODS:
                raise InvalidInput(f"{name}: it was made by another version of clothfit; build it again")
            parts = tuple(_part(file, c, about) for c in range(int(about["objects"])))
        model = Model(text, str(about["folder"]), parts, dict(about["limits"]), dict(about["built"]), about["method"])
    except InvalidInput:
        raise
    except (*npz.FAULTS, KeyError, TypeError, AttributeError, IndexError) as error:
        why = getattr(error, "strerror", None)
        raise InvalidInput(f"{name}: {why}" if why else f"{name}: it is no model of clothfit subspace build") from None
    check_arrays(model, name)
    return model


def _part(file: IO[bytes], c: int, about: dict[str, Any]) -> Part:
    found = npz.stored(file, [f"{each}{c}" for each in ("basis", "envelope", "normals", *Selection._fields)], "")

    def of(name: str, kind: Any = float) -> Any:
        return np.ascontiguousarray(found[f"{name}{c}"].read(), kind)

    pairs = zip(Selection._fields[::2], Selection._fields[1::2], strict=True)
    chosen = Selection(*(array for index, weight in pairs for array in (of(index, np.int32), of(weight))))
    normals = of("normals", np.float32) if f"normals{c}" in found else None
    network = weights.read_network(file, about["networks"][c], c) if about["method"] == NETWORK else None
    return Part(of("basis"), chosen, of("envelope"), normals, network, found[f"basis{c}"].dtype == np.float16)


def check_arrays(model: Model, name: str) -> None:
    """Raise InvalidInput where the arrays do not fit the scene."""
    scene = model.scene()
    fits = len(scene.cloths) == len(model.parts)
    for cloth, part in zip(scene.cloths, model.parts, strict=False):
        counts = {"springs": len(cloth.springs), "faces": len(cloth.triangles), "vertices": len(cloth.mass)}
        fits = fits and part.basis.ndim == 3 and part.basis.shape[:2] == (len(cloth.mass), 3)
        fits = fits and part.envelope.shape == (2, part.basis.shape[-1]) and bool(np.isfinite(part.basis).all())
        if part.normals is not None:
            shape = (*part.basis.shape[:2], 1 + part.basis.shape[-1])
            fits = fits and part.normals.shape == shape and bool(np.isfinite(part.normals).all())
        pairs = zip(part.chosen[::2], part.chosen[1::2], counts.values(), strict=True)
        for index, weight, count in pairs:
            fits = fits and index.ndim == 1 and index.shape == weight.shape and bool(np.isfinite(weight).all())
            fits = fits and bool(((index >= 0) & (index < count)).all())
        fits = fits and (part.network is None or weights.fits(part.network, part.basis.shape[-1]))
    if not fits:
        raise InvalidInput(f"{name}: its arrays do not fit its scene; build it again")


STAYS, TRANSLATED = -1, 0
"""Of `way`: a vertex that is fixed, and one that the mean of the pins carries; 1 + p follows pin p."""


class InitialState(NamedTuple):
    """An object at the start, which only the scene tells; the names of the fields are those of the arrays in MODEL."""

    start: NDArray[np.float32]  # x₀, (n, 3), m
    before: NDArray[np.float32]  # (r,), the coordinates that stand for those a step before the start
    triangles: Indices  # (T, 3)
    way: Indices  # (n,)

    @property
    def pins(self) -> int:
        """Number of pins."""
        return max(0, int(self.way.max(initial=0)))


def initial_state(scene: Scene, c: int, basis: Array) -> InitialState:
    """Object c of a scene, with its basis (n, 3, r)."""
    system = build(scene, c, steps=1)
    way = np.where(system.vertex.free, TRANSLATED, STAYS).astype(np.int32)
    if system.inputs is not None:
        way[system.inputs.pins] = 1 + np.arange(len(system.inputs.pins))
    before = -system.h * translation.start_velocity(system, basis)
    triangles = np.ascontiguousarray(scene.cloths[c].triangles, np.int32)
    return InitialState(system.x0.astype(np.float32), before.astype(np.float32), triangles, way)
