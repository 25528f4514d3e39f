"""The options of `clothfit estimate` for targets, objectives and the start, and the files it reads and writes.

In the names, {stem} stands for the scene's name without folder and suffix, {folder} for its folder, so that one option
can name the files of many scenes.

`clothfit estimate --simulator`: the values with which another tool's cloth moves like the target.

`clothfit estimate --cache FILE`: the fitted motion at the times of the target's frames, for the program it is from.

Where the target and FILE are USD, FILE is a copy of the target's file in which the points of the cloth's meshes are the
fitted ones: the same names, time codes, unit and axes, and all else that is there. Else FILE holds the cloth alone, in
the target's axes and unit where its format can have them.
"""

from __future__ import annotations

import glob
import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from clothfit.base.errors import InvalidInput
from clothfit.base.limits import is_number
from clothfit.base.messages import counted, metres
from clothfit.cli.common import motions
from clothfit.cli.common.console import Console
from clothfit.cli.common.motions import check_there, one_stream, read_scene
from clothfit.cli.common.options import check_least, gathered, given, refuse, tuned
from clothfit.cli.common.output import SCENE, STREAM, Output, companion_file, output_for, print_json, write_into
from clothfit.formats.axes import Axes, Convention, Reading
from clothfit.formats.registry import foreign, format_of

if TYPE_CHECKING:
    from collections.abc import Iterable

    from clothfit.motion.motion import Motion
    from clothfit.registration.record import Registration
    from clothfit.scene.scene import Scene
    from clothfit.simulators.estimate import Options
    from clothfit.simulators.values import Fitted


@dataclass(frozen=True)
class Files:
    """The options that name files."""

    target_paths: tuple[str, ...]  # of a motion, or of a motion and a scene
    start: str | None  # a number, or of a scene
    path: str | None  # of the result
    in_place: bool
    checkpoint: str | None
    resume: bool
    reading: Reading = Reading()  # noqa: RUF009  what the targets' files do not say; it cannot be changed
    forces_path: str | None = None  # on the cloths
    cache: str | None = None  # of the fitted motion

    def of(self, scene_path: str) -> Files:
        """The same for one scene: without stems."""
        return replace(
            self,
            target_paths=tuple(filled(path, scene_path) for path in self.target_paths),
            start=self.start and filled(self.start, scene_path),
            path=self.path and filled(self.path, scene_path),
            cache=self.cache and filled(self.cache, scene_path),
            checkpoint=self.checkpoint and filled(self.checkpoint, scene_path),
            reading=replace(self.reading, markers=self.markers and filled(self.markers, scene_path)),
        )

    @property
    def pairs(self) -> list[tuple[str, str | None]]:
        """Each target's motion and scene."""
        return [motion_and_scene(path) for path in self.target_paths]

    @property
    def markers(self) -> str | None:
        """The file that says which vertices markers are."""
        return None if self.reading.markers is None else os.fspath(self.reading.markers)

    @property
    def inputs(self) -> tuple[str | None, ...]:
        """What is read besides the scene."""
        start = None if self.start is None or is_number(self.start) else self.start
        paths = [path for pair in self.pairs for path in pair if not (path or "").startswith(SHADOWS)]
        paths += [each.partition("=")[2] for each in self.target_paths if each.startswith(SHADOWS[0])]
        return (*paths, start, self.markers, self.forces_path)

    def check(self, scene_path: str) -> None:
        """Raise InvalidInput where the options do not go together."""
        if self.in_place and (self.path is not None or scene_path == STREAM):
            raise InvalidInput("--in-place writes into the scene's file; it does not go with -o or standard input")
        one_stream(scene_path, *self.inputs)

    def output(self, scene_path: str) -> Output:
        """Where the fitted scene goes: by default beside the input, with the input's suffix. Raises InvalidInput."""
        if self.in_place:
            return output_for(scene_path, scene_path, "", (), overwrite=True)
        suffix = os.path.splitext(scene_path)[1]
        return output_for(self.path, scene_path, f".fitted{suffix}", self.inputs, text=SCENE)


MOST_STARTS = 10_000
"""Of one scene; each is kept until the end."""


@dataclass(frozen=True)
class Effort:
    """How many fits, how many at a time, and where."""

    starts: int
    seed: int
    jobs: int | None
    cluster: str | None

    def check(self) -> None:
        """Raise InvalidInput on values that cannot be."""
        check_least(1, starts=self.starts, jobs=self.jobs)
        check_least(0, seed=self.seed)
        if self.starts > MOST_STARTS:
            raise InvalidInput(f"--starts must be at most {MOST_STARTS}; {self.starts} was given")


def filled(name: str, scene_path: str) -> str:
    """A name with what {stem} and {folder} stand for; as it is where there is such a file."""
    if os.path.exists(name):
        return name
    path = Path(scene_path)
    return name.replace("{stem}", path.stem).replace("{folder}", str(path.parent))


def default_name(scene_path: str) -> str:
    """The name, without a folder, of a fitted scene."""
    path = Path(scene_path)
    return path.with_suffix(f".fitted{path.suffix}").name


def motion_and_scene(path: str) -> tuple[str, str | None]:
    """The paths in a --target: of a motion, or of a motion and a scene, split at the last @."""
    if "@" not in path or os.path.exists(path) or (glob.has_magic(path) and glob.glob(path)):
        return path, None
    motion, _, scene = path.rpartition("@")
    return motion, scene


SHADOWS = ("outline=", "coefficient=")
"""Beginnings of targets that are the shadow of a drape."""


def read_target(
    paths: tuple[str, str | None], scene: Scene, reading: Reading, console: Console, readings: list[dict[str, Any]]
) -> Motion | tuple[Motion, Scene]:
    """What a --target names; of other programs' files, what was assumed is added to `readings`."""
    motion, own = paths
    if motion.startswith(SHADOWS):
        other = scene if own is None else read_scene(own, console)
        return shadow(motion, other) if own is None else (shadow(motion, other), other)
    if own is None:
        return motions.read_motion(motion, scene, reading, console, readings)
    other = read_scene(own, console)
    return motions.read_motion(motion, other, reading, console, readings), other


def check_read(readings: list[dict[str, Any]], reading: Reading) -> None:
    """Raise InvalidInput where a target fits the scene by axes or a unit other than those that were assumed of it."""
    for each in readings:
        fits = str(each["advice"] or "")
        assumed = [name for name in Axes._fields if f"--{name} " in fits and getattr(reading, name) is None]
        if assumed and fits.startswith("--"):
            as_it_is = " ".join(f"--{name} {each[name]}" for name in assumed)
            raise InvalidInput(f"{each['file']}: it begins far from the scene, and {fits}; {as_it_is} fits it as it is")


def shadow(text: str, scene: Scene) -> Motion:
    """The target outline=FILE or coefficient=NUMBER. Raises InvalidInput."""
    from clothfit.motion.shadow import shadow_target

    kind, _, value = text.partition("=")
    if kind == "coefficient":
        share = value.removesuffix("%")
        if not is_number(share):
            raise InvalidInput(f"--target {text}: the drape coefficient is a number, as in coefficient=62%")
        return shadow_target(scene, coefficient=float(share) / (100.0 if value.endswith("%") else 1.0))
    check_there(value)
    import numpy as np

    try:
        points = np.loadtxt(value, delimiter="," if "," in Path(value).read_text("utf-8") else None, ndmin=2)
    except (OSError, ValueError) as error:
        raise InvalidInput(f"{value}: is no outline, which has x and z in m in each line: {error}") from None
    return shadow_target(scene, outline=points)


def weights(objectives: tuple[str, ...], targets: tuple[str, ...] = ()) -> dict[str, float]:
    """The weight of each --objective, 1 where it has none; without any, what the targets show. Raises InvalidInput."""
    shown = {target.partition("=")[0] + "=" if target.startswith(SHADOWS) else "" for target in targets}
    if not objectives and len(shown) > 1:
        raise InvalidInput("--target: an outline, a coefficient and other targets show different things; fit each by "
                           "itself, or name what all of them are compared by with --objective")  # fmt: skip
    found, usual = {}, {"outline=": "outline", "coefficient=": "coverage"}
    for text in objectives or tuple(usual.get(each, "position") for each in shown) or ("position",):
        name, equals, weight = text.partition("=")
        if name in found:
            raise InvalidInput(f"--objective: {name} is given twice")
        if equals and not is_number(weight):
            raise InvalidInput(f"--objective: {text}: the weight is not a number, as in {name}=0.01")
        found[name] = float(weight) if equals else 1.0
    return found


def bounds_of(texts: tuple[str, ...]) -> dict[str, tuple[float | None, float | None]] | None:
    """The bounds of each --bounds KIND=LOW:HIGH, either of which may be left out; None without any."""
    found: dict[str, tuple[float | None, float | None]] = {}
    for text in texts:
        name, equals, ends = text.partition("=")
        low, colon, high = ends.partition(":")
        numbers = [end.strip() for end in (low, high)]
        if not equals or not colon or not any(numbers) or not all(is_number(end) for end in numbers if end):
            raise InvalidInput(f"--bounds: {text!r} is not KIND=LOW:HIGH, as in stiffness=1:1e6 or mass=1e-6:")
        if name in found:
            raise InvalidInput(f"--bounds: {name} is given twice")
        found[name] = float(low) if numbers[0] else None, float(high) if numbers[1] else None
    return found or None


def read_start(start: str | None, console: Console) -> float | Scene | None:
    """What --start says: a value, or a scene's file."""
    if start is None:
        return None
    return float(start) if is_number(start) else read_scene(start, console)


MODELS = {"xpbd": ("G", "L"), "blender": ("G",)}
"""The few values of a tool, or those of each constraint and vertex."""


@dataclass(frozen=True)
class Given:
    """The options as they are given."""

    simulator: str | None = given("--simulator TOOL", "Fit the values of another tool's cloth, so that it moves like "
        "the target: xpbd, or blender, which needs Blender.")
    iterations: int | None = tuned("--iterations N", "Iterations of xpbd in a substep; --substeps is how many of those "
        "there are in a step.  [default: 10, and 1 substep]", int)
    bends_by: str = tuned("--bends-by WHAT", "Bending of xpbd: by distance, as the springs, or by angle.  [default: "
        "distance]", default="distance")
    blender: str | None = tuned("--blender PROGRAM", "Blender, or a Python that has it as a module.  [default: "
        "CLOTHFIT_BPY, else blender]")

    def check(self, model: str | None) -> None:
        """Raise UsageError, InvalidInput on what cannot be."""
        from clothfit.simulators.estimate import SIMULATORS

        if self.simulator is not None and self.simulator not in SIMULATORS:
            raise InvalidInput(f"--simulator: there is no {self.simulator!r}; use {' or '.join(SIMULATORS)}")
        if self.simulator != "xpbd" and (self.iterations is not None or self.bends_by != "distance"):
            raise click.UsageError("--iterations and --bends-by are for --simulator xpbd")
        if self.simulator and model not in (None, *MODELS[self.simulator]):
            known = " and ".join(MODELS[self.simulator])
            raise InvalidInput(f"--model {model}: the values of {self.simulator} are fitted by {known}")
        if self.simulator != "blender" and self.blender is not None:
            raise click.UsageError("--blender is for --simulator blender")

    def options(self, substeps: str | None, model: str | None, console: Console) -> Options:
        """What to fit in. Raises InvalidInput."""
        from clothfit.simulators import xpbd
        from clothfit.simulators.estimate import Options

        if substeps is not None and not substeps.isdigit():
            raise InvalidInput(f"--substeps must be a whole number with --simulator; {substeps!r} was given")
        iterations = 10 if self.iterations is None else self.iterations
        own = xpbd.Settings(int(substeps or 1), iterations, self.bends_by)
        own.check()
        return Options(str(self.simulator), own, self.blender, report=console.detail, model=model or "G")


simulator_options = gathered("tool", Given)
"""Adds the options; the function is given them as `tool`."""


def fit_by_simulator(
    scene_paths: tuple[str, ...], files: Files, given: Given, substeps: str | None, model: str | None, console: Console
) -> int:
    """Fit a tool to one scene's target and write its values into a folder; returns the exit code."""
    options = given.options(substeps, model, console)
    if len(scene_paths) != 1 or len(files.target_paths) > 1:
        raise click.UsageError("--simulator takes one SCENE and one --target")
    without = {"--start": files.start, "--checkpoint": files.checkpoint, "--forces": files.forces_path}
    refuse(without, "{} does not go with --simulator")
    (scene_path,) = scene_paths
    files = files.of(scene_path)
    if files.in_place or files.path == STREAM or (scene_path == STREAM and files.path is None):
        raise InvalidInput("--simulator: the result is several files, which need a folder; name one with -o")
    scene = read_scene(scene_path, console)
    folder = files.path or f"{Path(scene_path).stem}-{given.simulator}"
    motion = None
    if files.pairs:
        own = read_target(files.pairs[0], scene, files.reading, console, [])
        motion, scene = own if isinstance(own, tuple) else (own, scene)
    if given.simulator == "blender":
        from clothfit.simulators.blender import left_out

        if lost := left_out(scene):
            console.warn(f"{scene.name}: Blender's cloth is fitted without {' and '.join(lost)}")
    console.announce_compilation()
    from clothfit.simulators import written
    from clothfit.simulators.estimate import estimate

    found = estimate(scene, motion, options)
    made = written.files(scene, found, options)
    write_into(folder, made, scene_path, files.inputs)
    for number, each in enumerate(found):
        describe(number, each, console)
    console.say(f"{scene.name}: values of {given.simulator} → {folder}: {', '.join(made)}")
    print_json({"scene": scene.name, "output": folder, "files": list(made), **written.summary(found, options)})
    return 0


def describe(number: int, found: Fitted, console: Console) -> None:
    """Print what was found for an object."""
    first = found.few or found
    pairs = zip(first.tool.values, first.found, strict=True)
    rows = [(value.name, f"{value.mapped:.4g}", f"{fitted:.4g}", value.unit) for value, fitted in pairs]
    console.table([("value", "mapped", "fitted", "unit"), *rows])
    if found.few:
        console.say(f"objects[{number}] in {found.tool.name}, few values: RMSE {error(first.rmse, found.travel)}")
        for name, _, _, fitted in found.kinds():
            middle = sorted(fitted)[len(fitted) // 2]
            console.say(f"{name} of each: {fitted.min():.4g} … {fitted.max():.4g}, median {middle:.4g}")
    console.say(
        f"objects[{number}] in {found.tool.name}: RMSE {error(found.rmse, found.travel)}; with the mapped values "
        f"{error(first.mapped_rmse, found.travel)}; {found.simulations} simulations"
    )


def error(rmse: float, displacement: float) -> str:
    """A distance, and its part of the way from the start."""
    if rmse == float("inf"):
        return "of a cloth that runs away"
    return f"{metres(rmse)} ({100 * rmse / displacement:.2g} % of the way)"


def cache_place(files: Files, used: Iterable[str | None]) -> Output | None:
    """Where the cache goes, where one is asked for. Raises InvalidInput."""
    if files.cache is None:
        return None
    if len(files.pairs) != 1 or files.pairs[0][1] is not None:
        raise InvalidInput("--cache needs one --target, which must be of SCENE itself")
    out = companion_file("--cache", files.cache, used)
    assert out is not None
    format_of(out.path, writing=True)
    motions.check_output(out, Convention(), [files.pairs[0][0]])
    return out


def write_cache(fitted: Scene, files: Files, known: Registration, out: Output, console: Console) -> None:
    """Write the motion of a fitted scene in the time and the place of its target, which are `known`; before the scene
    begins it stands still. Raises InvalidInput.
    """
    import numpy as np

    from clothfit.motion.foreign import load
    from clothfit.motion.motion import Motion
    from clothfit.motion.simulate import simulate
    from clothfit.motion.times import frame_places, interpolated

    path, written = files.pairs[0][0], foreign(out.path)
    target = load(path, fitted, replace(files.reading, frames=None))
    own = replace(target.motion, times=np.maximum(known.times(target.motion.times), 0.0))
    step, fraction = frame_places(own, fitted.delta)
    every = simulate(fitted, int(step.max()) + 2)
    x = known.taken_back(interpolated(every.positions, step, fraction))
    motion = Motion(x, target.motion.times, fitted.vertex_counts)
    axes = target.interpretation.axes
    if written is not None and written.name == "USD" == target.interpretation.format:
        from clothfit.formats import usd
        from clothfit.motion.files import animation, for_tools

        whole, _ = for_tools(motion, fitted, written)
        points = animation(whole, written, axes).positions
        out.write(usd.with_points(path, out.path, points, str(target.motion.said.get("mesh", ""))))
        console.say(f"{out.path}: {path} with the fitted cloth, {counted(len(x), 'frame', 'frames')}, {axes}")
        return
    alike = written is not None and foreign(path) is not None and written.name != "glTF"
    motions.write_motion(motion, out, fitted, Convention(*_said(axes)) if alike else Convention(), console)


def _said(axes: Axes) -> tuple[float, str, str]:
    return axes.scale, axes.up, axes.handedness
