"""Motions in USD files (.usd, .usda, .usdc): a mesh whose points have samples over time.

The file names its up axis, its unit (metersPerUnit) and how many time codes make a second; it is right-handed. USD
stores points as float32. Of several meshes the reader takes those with animated points, in the order of their paths; it
applies transforms, makes fans of triangles from polygons, and follows no references to other files. Another process
reads the file (`usd_reader` says why), from a copy that nobody changes.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from typing import IO, Any

import numpy as np

from clothfit.base.arrays import Array
from clothfit.base.errors import InvalidMotion
from clothfit.base.writing import Data
from clothfit.formats.animation import Animation, rate_of, times_of
from clothfit.formats.axes import Axes
from clothfit.formats.files import content, name_of

READER = "clothfit.formats.usd_reader"

ALONE = {"PXR_WORK_THREAD_LIMIT": "1", "OPENBLAS_NUM_THREADS": "1", "MALLOC_ARENA_MAX": "2"}
"""Environment of that process: threads, and what each reserves, would count against its memory."""

CODES_PER_SECOND = 24.0
"""Time codes per second where frames are not at an even rate; a code may be any number."""

PATH = "/cloth"

PART = "part "
"""Before the names of the parts of a mesh, among the arrays of the other process."""


def read(path: str | os.PathLike[str], wanted: str = "") -> Animation:
    """The animated meshes of a file, or those that are `wanted`, one frame when nothing moves. Raises InvalidMotion."""
    arrays = arrays_of(path, *(["mesh", wanted] if wanted else []))
    up, handedness, scale, *notes = json.loads(str(arrays["axes_and_notes"]))
    axes = Axes(up, handedness, scale)
    parts = tuple((key.removeprefix(PART), own) for key, own in arrays.items() if key.startswith(PART))
    return Animation(
        arrays["positions"], axes, arrays.get("times"), arrays.get("triangles"), notes=tuple(notes),
        texture=arrays.get("texture"), parts=parts, pins=arrays.get("pins"),
    )  # fmt: skip


def paths(path: str | os.PathLike[str]) -> list[str]:
    """The paths of all meshes of a file. Raises InvalidMotion."""
    found: list[str] = arrays_of(path, "list")["paths"].tolist()
    return found


def with_points(path: str | os.PathLike[str], out: str, positions: Array, wanted: str) -> Data:
    """A copy of a file, as text where `out` ends so, in which the meshes that `read` takes have other points, (frames,
    n, 3), in its axes and unit. Raises InvalidMotion.
    """
    with tempfile.TemporaryDirectory(prefix="clothfit-") as folder:
        points = os.path.join(folder, "points.npy")
        np.save(points, positions)
        made = os.path.join(folder, "made" + os.path.splitext(out)[1].lower())
        arrays_of(path, "replace", wanted, points, made)
        with open(made, "rb") as file:
            return file.read()


def arrays_of(path: str | os.PathLike[str], *asked: str) -> dict[str, Any]:
    """The arrays that the reader finds in a file, of what is `asked` of it. Raises InvalidMotion."""
    name, data = name_of(path), content(path)
    with tempfile.TemporaryDirectory(prefix="clothfit-") as folder:  # the library's crash reports go there as well
        copy = os.path.join(folder, "motion" + os.path.splitext(os.fspath(path))[1].lower())
        with open(copy, "wb") as file:
            file.write(data)
        arrays = os.path.join(folder, "arrays.npz")
        command = [sys.executable, "-P", "-m", READER, copy, arrays, name, *asked]
        around = {**os.environ, "PYTHONPATH": os.pathsep.join(map(os.path.abspath, sys.path)), "TMPDIR": folder}
        done = subprocess.run(command, env={**around, **ALONE}, stdin=subprocess.DEVNULL, capture_output=True)
        if done.returncode == 3 and done.stdout:
            raise InvalidMotion(json.loads(done.stdout))
        if done.returncode:
            raise InvalidMotion(f"{name}: the USD library cannot read it; it is damaged, or of another format")
        with np.load(arrays, allow_pickle=False) as loaded:
            return {key: loaded[key] for key in loaded.files}


def encoded(path: str | os.PathLike[str], animation: Animation) -> dict[str, Data]:
    """The file, text where its suffix is .usda. Every position must be known."""
    positions = animation.positions
    suffix = os.path.splitext(os.fspath(path))[1].lower()

    def write(file: IO[bytes]) -> None:
        with tempfile.TemporaryDirectory(prefix="clothfit-") as folder:
            made = os.path.join(folder, "motion" + suffix)
            stage = _stage(positions, animation)  # a layer lives no longer than its stage
            try:
                stage.GetRootLayer().Export(made)
            except RuntimeError:  # the library's own error, many lines long
                raise OSError("the USD library cannot write it; is the disk full?") from None
            with open(made, "rb") as whole:
                file.write(whole.read())

    return {os.fspath(path): write}


def _stage(positions: Array, animation: Animation) -> Any:
    """A stage with one mesh, or points where there are no faces."""
    from pxr import Usd, UsdGeom, Vt

    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageUpAxis(stage, animation.axes.up.upper())
    UsdGeom.SetStageMetersPerUnit(stage, animation.axes.scale)
    rate = rate_of(animation)
    rate = CODES_PER_SECOND if rate is None else rate
    codes = times_of(animation) * rate
    codes = np.where(np.abs(codes - np.round(codes)) < 1e-6, np.round(codes), codes)  # times are rounded
    stage.SetTimeCodesPerSecond(rate)
    stage.SetFramesPerSecond(rate)
    if animation.triangles is None:
        shape = UsdGeom.Points.Define(stage, PATH)
    else:
        shape = UsdGeom.Mesh.Define(stage, PATH)
        shape.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(np.full(len(animation.triangles), 3, np.int32)))
        shape.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(animation.triangles.astype(np.int32).reshape(-1)))
        shape.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
        shape.CreateDoubleSidedAttr(True)
    stage.SetDefaultPrim(shape.GetPrim())
    points, extent = shape.CreatePointsAttr(), shape.CreateExtentAttr()
    moves = len(positions) > 1
    for frame, code in zip(positions.astype(np.float32), codes, strict=True):
        when = Usd.TimeCode(float(code)) if moves else Usd.TimeCode.Default()
        points.Set(Vt.Vec3fArray.FromNumpy(frame), when)
        extent.Set(Vt.Vec3fArray.FromNumpy(np.stack([frame.min(axis=0), frame.max(axis=0)])), when)
    if moves:
        stage.SetStartTimeCode(float(codes[0]))
        stage.SetEndTimeCode(float(codes[-1]))
    return stage
