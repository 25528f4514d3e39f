"""What provokes each error of `docs/errors.md`, by its message: commands, some with replaced parts of the program.

A command runs in a folder with `scene.json` (4 × 4 vertices, one mass to fit, 5 frames), `good.npz` (its motion) and
whatever `Case` adds. Processes and clusters are in `staged`, calls from Python in `unasked`.
"""

from __future__ import annotations

import errno
import io
import os
import shlex
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import jsonschema
import numpy as np
import pytest

from clothfit.cli.program import run
from clothfit.fit import estimate as fitting
from clothfit.optimise import checkpoint
from clothfit.optimise.checkpoint import FORMAT, Record, checksum, decoded, encoded
from helpers.archives import DAMAGED
from helpers.scenes import MISSING, changed, even, trial

CLOTH = ("objects", 0)
VERTICES, SPRINGS = 16, 33
SMALL = trial("nG", 5)
GOOD = {"positions": np.zeros((5, VERTICES, 3)), "times": 0.02 * np.arange(5)}


@dataclass(frozen=True)
class Case:
    """A command and the files around it: bytes, documents, or arrays of motions by their names."""

    arguments: str
    files: Mapping[str, Any] = field(default_factory=dict)
    prepare: Callable[[Any], object] = lambda patch: None  # is given pytest's monkeypatch


def scene(path: tuple[str | int, ...], value: Any) -> Case:
    """A simulation of the scene with another value at a path."""
    return Case("simulate scene.json", {"scene.json": changed(SMALL, path, value)})


def own(name: str, *rest: Any) -> Case:
    """The same with a path in the object: name, further steps, value."""
    return scene((*CLOTH, name, *rest[:-1]), rest[-1])


def text(data: bytes) -> Case:
    """A scene of that text."""
    return Case("simulate scene.json", {"scene.json": data})


def motion(**arrays: Any) -> Case:
    """A fit to a motion with other arrays; None takes one away."""
    made = {name: array for name, array in {**GOOD, **arrays}.items() if array is not None}
    return Case("estimate scene.json --target bad.npz", {"bad.npz": made})


def fit(options: str = "", of: Any = SMALL, **files: Any) -> Case:
    """A fit with options."""
    return Case(f"estimate scene.json {options}", {"scene.json": of, **files})


def speed(options: str) -> Case:
    """A comparison of speeds."""
    return Case(f"evaluate scene.json --speed {options}")


def patched(case: Case, name: str, value: Any) -> Case:
    """A case in which something of the program, or of the system, is replaced."""
    return Case(case.arguments, case.files, lambda patch: patch.setattr(name, value, raising=False))


def raising(error: BaseException) -> Callable[..., Any]:
    """A function that fails."""

    def function(*_: Any, **__: Any) -> Any:
        raise error

    return function


def free(size: int) -> Any:
    """The module `memory`, where that many bytes are free."""
    return SimpleNamespace(free=lambda: size)


def read_only(patch: Any) -> None:
    """The answer of a system where nothing is writable; a test that root runs could write everywhere."""
    access = os.access
    patch.setattr("clothfit.base.writing.os.access", lambda path, mode: mode & os.W_OK == 0 and access(path, mode))


def closing(patch: Any) -> None:
    """The same, from the end of a fit on."""
    original = fitting.fit

    def closed(*arguments: Any) -> Any:
        found = original(*arguments)
        read_only(patch)
        return found

    patch.setattr(fitting, "fit", closed)


def piped(_: Any) -> None:
    """A pipe in the folder."""
    if not hasattr(os, "mkfifo"):
        pytest.skip("this system has no pipes")
    os.mkfifo("pipe")


def large(_: Any) -> None:
    """A file of 1 GB, which takes no place."""
    with open("large", "wb") as file:
        file.truncate(10**9)


def growing(patch: Any) -> None:
    """A scene that is saved anew while it is read."""

    class Saved(io.FileIO):
        def read(self, size: int = -1) -> bytes:
            os.utime(self.name)
            return super().read(size)

    patch.setattr("clothfit.base.reading.open", lambda path, mode: Saved(path), raising=False)


def unlikely(_: Any) -> None:
    """A checkpoint of the same fit, with the right checksum, whose records are none of a fit."""
    assert run([*shlex.split(RESUMED.replace("--resume", "")), "--max-evaluations", "2", "-q"]) == 5
    with open("c", "rb") as file:
        identity, content = decoded(file.read(), "c")
    records = [Record(record.name, np.zeros(0)) for record in content.records]
    with open("c", "wb") as file:
        file.write(encoded(identity, content._replace(records=records)))


def full(patch: Any) -> None:
    """Standard output on a device without room."""
    patch.setattr("clothfit.cli.common.shared.sys.stdout", SimpleNamespace(buffer=Full(), isatty=lambda: False))


class Full(io.BytesIO):
    """A stream to which nothing can be written."""

    def write(self, data: Any) -> int:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def kept_nowhere(patch: Any) -> None:
    """Compiled code that could not be written; there is nothing to compile."""
    patch.setattr("clothfit.kernels.cache.KernelCache.failed", True)
    patch.setattr("clothfit.many.warmup.SMALL", {})


def ruled(patch: Any) -> None:
    """A schema with a rule that has no words of its own; none of today's is such."""
    schema = {"properties": {"delta": {"multipleOf": 7}}}
    patch.setattr("clothfit.scene.schema.conforms", lambda *_: False)
    patch.setattr("clothfit.scene.schema._validator", lambda: jsonschema.Draft202012Validator(schema))


MOVE, EVALUATE, TARGET = Case("simulate scene.json"), "evaluate scene.json ", "target scene.json "
NOTHING = trial("nn", 5)
HARD = even("nG", 60, integrationMethod=0, delta=0.004, springStiffness=[1e3] * SPRINGS)  # explicit steps are too long
PLACE = {"x": 0, "y": 0, "z": 0}
FAR = {"x": 1e300, "y": 0, "z": 0}
OTHER = trial("nG", 5, nx=3)
DEEP = b"[" * 200_000
HELD = trial("nG", 5, vertIsFixed=[True] * VERTICES)
UNSEEN = {**GOOD, "observed": np.zeros((5, VERTICES), bool)}
RESUMED = "estimate scene.json --target good.npz --method l-bfgs-b --start 0.01 --resume --checkpoint c"
GONE = even("nG", 40, integrationMethod=0, delta=1.0, damping=1e3)  # whatever its stiffness is
STILL = np.array([[p["x"], p["y"], p["z"]] for p in GONE["objects"][0]["vertPos"]])

SWITCHING = patched(
    Case("check scene.json"), "clothfit.inspection.ladder.first_switch", lambda a, b: "vertex 1 at sphere 0"
)

COMMANDS: dict[str, Case] = {
    # usage
    "no such command …": Case("fold"),
    "no such option …": fit("--fast"),
    "missing argument …": Case("simulate"),
    "missing option …": Case("export scene.json"),
    "got unexpected extra argument…": Case("simulate a.json b.json"),
    "option … requires an argument": Case("simulate scene.json --steps"),
    "option … does not take a value": Case("simulate scene.json --quiet=3"),
    "invalid value for …": Case("simulate scene.json --steps many"),
    "--speed takes one scene; … does not go with it": Case(EVALUATE + "scene.json --speed"),
    "… goes with --fit only": speed("--max-evaluations 3"),
    "… goes with --speed only": Case(EVALUATE + "scene.json --budget 3"),
    "--jobs is for this machine; a --cluster has its own workers": fit("--cluster tcp://127.0.0.1:1 --jobs 2"),
    "--checkpoint and --resume are for fits on this machine, not on a --cluster": fit("--cluster tcp://x:1 --resume"),
    "standard input and output (-) are for one scene, not for …": fit("-"),
    "--checkpoint: … scenes need one each: put {stem} into the name": fit("b.json --checkpoint c"),
    "-o …: … scenes need a folder, or a name with {stem}": fit("b.json -o c.json"),
    # values
    "--steps must be at least 1; … was given": Case("simulate scene.json --steps 0"),
    "--max-evaluations must be at least 1; … was given": fit("--max-evaluations 0"),
    "--rmse must be at least 0; … m was given": fit("--rmse -1"),
    "--… must be at least …; … was given": fit("--starts 0"),
    "--starts must be at most …; … was given": fit("--starts 1000000000"),
    "… must be above 0 and finite; … was given": speed("--budget 0"),
    "--in-place writes into the scene's file; it does not go with -o or standard input": fit("--in-place -o x.json"),
    "--objective: … is given twice": fit("--objective velocity --objective velocity=2"),
    "--objective: …: the weight is not a number, as in …=0.01": fit("--objective velocity=much"),
    "objective: there is no …; use …": fit("--objective colour"),
    "objective: …: the weight must be above 0 and finite; … was given": fit("--objective position=0"),
    "loss: there is no …; use …": fit("--loss total"),
    "loss scale: the linear loss has none; choose the loss soft_l1 or huber with it": fit("--loss-scale 0.1"),
    "loss scale must be above 0 and finite; … m was given": fit("--loss huber --loss-scale 0"),
    "loss scale must be within … m; … m was given": fit("--loss huber --loss-scale 1e300"),
    "tolerance must be above 0 and below 1; … was given": Case("simulate scene.json --tolerance 1"),
    "noise must be at least 0 and finite; … m was given": Case(TARGET + "--noise -1"),
    "observed must be a fraction above 0 and at most 1; … was given": Case(TARGET + "--observed 0"),
    "every must be at least 1; … was given": Case(TARGET + "--every 0"),
    "fps must be above 0 and finite; … was given": Case(TARGET + "--fps inf"),
    "fps: does not go with every; each says which frames there are": Case(TARGET + "--fps 30 --every 2"),
    "method: there is no …; use …": fit("--method magic"),
    "prior must be auto, none or a width in log parameters above 0; … was given": fit("--prior -1"),
    "holdout: there is nothing called … to keep out; use …": fit("--holdout 0.2 --holdout-of springs"),
    "holdout must be a fraction above 0 and below 1; … was given": fit("--holdout 1"),
    "start: … is not within the bounds …": fit("--start 1e9"),
    "memory: … is not a size; give one such as 200MB, 2GiB or 1.5G": fit("--memory much"),
    "memory must be between 1 byte and 8 EiB; … was given": fit("--memory 0"),
    "a picture's name ends in …": speed("--plot x.gif"),
    "a picture needs …; install it with: pip install 'clothfit[plot]'": Case(
        speed("--plot x.svg").arguments, {}, lambda patch: patch.setitem(sys.modules, "matplotlib", None)
    ),
    "standard input (-) can be only one of the inputs": Case("evaluate - -"),
    "NUMBA_DISABLE_JIT is set, so nothing is ever compiled": patched(
        Case("warmup"), "clothfit.kernels.cache.config.DISABLE_JIT", 1
    ),
    # memory
    "… frames of … vertices take …, … of memory are free; use fewer frames (--steps, --fps, optimizationIterations)":
        Case("simulate scene.json --steps 100000000000"),
    "memory: … is too little: the targets take …, and a fit of … steps of … vertices needs … in all": fit(
        "--memory 1kB"
    ),
    "memory: too little for the balance of momentum; use another method, or allow more": patched(
        fit("--method momentum"), "clothfit.optimise.momentum.fits", lambda objective: False
    ),
    "takes … of memory, … are free; keep fewer frames": patched(
        fit("--target good.npz"), "clothfit.motion.motion.memory", free(1000)
    ),
    "to read it takes about … of memory, … are free": patched(MOVE, "clothfit.scene.text.memory", free(1000)),
    "… steps of … vertices, with … velocities each, take … of memory, … are free; use fewer iterations "
    "(forwardSubSteps)": scene(("forwardSubSteps",), 2_000_000_000),
    "out of memory; try fewer frames (--steps, optimizationIterations)": patched(
        MOVE, "clothfit.simulate", raising(MemoryError())
    ),
    # reading
    "cannot be read: …": Case("simulate absent.json"),
    "there is no such file": fit("--target absent.npz"),
    "is a folder, a motion file (.npz) is needed": fit("--target ."),
    "cannot be read as .npz or .npy (…)": fit("--target scene.json"),
    "it has more than the …": Case("simulate large", prepare=large),
    "it changed while it was read; try again": Case("simulate scene.json", prepare=growing),
    **{
        reason: patched(
            Case("estimate scene.json --target bad.npz", {"bad.npz": data}), "clothfit.base.npz.UNPACKED_FREELY", 1000
        )
        for reason, data in DAMAGED.items()
    },
    # text
    "the file is empty; a scene is a JSON object": text(b""),
    "byte … (0x…) is not … text; save the file as UTF-8": text(b'{"title": "\xe9"}'),
    "not JSON text (UTF-16 without a byte order mark?); save the file as UTF-8": text("{}".encode("utf-16-le")),
    "the text ends inside a value; is the file complete?": text(b'{"delta": '),
    "not JSON: …": text(b"{'delta': 1}"),
    "line …, column …: … is not JSON; a finite number is needed": scene(("mine",), float("nan")),
    "the JSON is nested too deeply to be a scene (more than … levels)": text(DEEP),
    "the key … appears more than once; keep one": text(b'{"delta": 1, "delta": 2}'),
    "the key appears more than once in an object; keep one": text(b'{"a": {"x": 1, "x": 2}, "a": 3}'),
    # scene
    "is missing, and it has no default": scene(("delta",), MISSING),
    "… is not …": scene(("title",), 5),
    "… is not one of …": scene(("integrationMethod",), 7),
    "… is too small; it must be above …": scene(("delta",), 0),
    "… is too large; it must be below …": scene(("tolerance",), 1),
    "… is too large; it must be at most …": scene(("optimizationIterations",), 10**30),
    "… is too small; it must be at least …": scene(("optimizationIterations",), 0),
    "is empty; at least … is needed": scene(("objects",), []),
    "… breaks the rule …": Case("simulate scene.json", prepare=ruled),
    "… is not two letters of n, G, L (masses, then stiffnesses)": own("optimizationSettings", "x"),
    "cannot be fitted; … can": scene(("fit",), {"colour": "G"}),
    "… is not a finite number within the range of doubles": own("vertPos", 5, "x", float("inf")),
    "… is not a number": own("vertMass", 3, "heavy"),
    "… is not true or false": own("vertIsFixed", 2, 1),
    "… is not an index (a whole number)": own("springs", 3, 3.5),
    "… is not a vector (an object with x, y and z)": own("vertPos", 5, 3),
    "is missing; a vector needs x, y and z": own("vertPos", 5, {"x": 0, "y": 0}),
    "….vertPos: is empty; an object needs at least one vertex": own("vertPos", []),
    "vertex … does not exist (…)": own("springs", 3, 144),
    "… indices do not make …; a multiple of … is needed": own("triangles", [0, 1, 2, 3]),
    "… for …; one each is needed": own("vertMass", [1.0]),
    "the … must be …": own("vertMass", 3, -1),
    "vertex … is joined to itself; a spring needs two vertices": own("springs", 1, 0),
    "vertices … and … lie at the same place; a spring needs a rest length above 0": own("vertPos", 1, PLACE),
    "vertices … and … are too far apart; the spring's rest length is not finite": own("vertPos", 5, FAR),
    # motion
    "positions: is missing": motion(positions=None),
    "has type …, numbers are needed": motion(positions=np.full((5, VERTICES, 3), "a")),
    "has shape …, (frames, …, 3) fits …": motion(positions=np.zeros((5, 7, 3))),
    "is …, the scene has …": motion(vertex_counts=np.array([7])),
    "needs … numbers, one per frame": motion(times=np.zeros(3)),
    "must be finite and increasing": motion(times=np.zeros(5)),
    "…, (…, …) bool fits": motion(observed=np.ones((5, 7), bool)),
    "…, though not marked as unobserved": motion(positions=np.full((5, VERTICES, 3), np.nan)),
    "…, (…,) or (…, …) numbers fit": motion(weights=np.ones(3)),
    "weights… must be at least 0 and finite; … was given": motion(weights=-np.ones(VERTICES)),
    "times[…]: … s is too many steps away": motion(times=1e9 * np.arange(5)),
    "times[0]: … s is before the start, which is at 0 s": motion(times=np.arange(5) - 1.0),
    "times[…]: the spectrum needs frames at equal distances in time": Case(
        "estimate scene.json --target bad.npz --objective spectrum",
        {
            "scene.json": trial("nG", 30),
            "bad.npz": {"positions": np.zeros((9, VERTICES, 3)), "times": 0.02 * np.array([0, 1, 2, 3, 4, 5, 6, 7, 9])},
        },
    ),
    "… of its frames are compared; the spectrum needs at least …": fit(
        "--target good.npz --objective spectrum", trial("nG", 2)
    ),
    # together
    "delta: … steps of … s do not end at a finite time": scene(("delta",), 1e308),
    "nothing to fit: no object flags anything; set its optimizationSettings, for example to 'nL', or its fit": fit(
        of=NOTHING
    ),
    "--fit: no object flags anything to fit; set its optimizationSettings": Case(
        speed("--fit").arguments, {"scene.json": NOTHING}
    ),
    "shows nothing after the start that can move, within … frames, so there is nothing to fit to": motion(
        observed=np.zeros((5, VERTICES), bool)
    ),
    "shows … frames, too few to keep some of them out of the fit": fit("--holdout 0.5", trial("nG", 2)),
    "shows too few vertices to keep some of them out of the fit": fit(
        "--holdout 0.5 --holdout-of vertices",
        trial("nG", 5, vertIsFixed=[i > 0 for i in range(VERTICES)]),
    ),
    "objects[…] has … values of …, … are needed": fit("--start other.json", **{"other.json": OTHER}),
    "its objects have (vertices, springs) …, those of …": Case(EVALUATE + "other.json", {"other.json": OTHER}),
    "its delta is … s, that of … s": Case(EVALUATE + "other.json", {"other.json": {**SMALL, "delta": 0.01}}),
    "shows no observed vertex in the first … frames": Case(
        EVALUATE + "scene.json --target bad.npz", {"bad.npz": UNSEEN}
    ),
    "shows nothing after the start that can move, within … frames, so there is nothing to check the gradient with; "
    "ask for more --steps": Case("check scene.json --target bad.npz", {"bad.npz": UNSEEN}),
    "whether the gradient is right cannot be seen here (…); try fewer or more --steps": Case(
        "check scene.json", {"scene.json": HELD}
    ),
    "… of … steps are short enough and above rounding, … are needed": Case("check scene.json", {"scene.json": HELD}),
    "the cost has a kink here, within … of the values: …": SWITCHING,
    "contacts switch (objects[…] …)": SWITCHING,
    "… and … would both be written to …; use {folder} in -o": fit("a/scene.json -o out/", **{"a/scene.json": SMALL}),
    # writing
    "cannot write …: …": Case(f"simulate scene.json -o {'n' * 300}"),
    "it is a folder": Case("simulate scene.json -o ."),
    "it does not name a file": Case("simulate scene.json -o absent/"),
    "the file is there and is not writable": Case("simulate scene.json -o good.npz", {}, read_only),
    "the folder … does not exist": Case("simulate scene.json -o absent/x.npz"),
    "the folder … is not writable": Case("simulate scene.json -o x.npz", {}, read_only),
    "cannot write …: it is an input, which is never written over; name another file": Case(
        "simulate scene.json -o scene.json"
    ),
    "cannot write …: it is an input, which is never written over": Case(
        "evaluate x.svg --speed --plot x.svg", {"x.svg": SMALL}
    ),
    "--dump must be a file of its own; … was given": Case("simulate scene.json --dump -"),
    "cannot write …: it is an input, which is never written over; leave it out, or name a folder with -o": fit(
        "scene.fitted.json", **{"scene.fitted.json": SMALL}
    ),
    "cannot make the folder …: …": fit("b.json -o scene.json/out/"),
    "a motion is not text, so it is not written to a terminal; name a file with -o": patched(
        Case("simulate scene.json -o -"), "sys.stdout.isatty", lambda: True
    ),
    "changed while the fit ran, so it is left as it is; the result is in …": patched(
        fit("--in-place"), "clothfit.cli.common.shared.unchanged", lambda scene, path: False
    ),
    "…; then repeat the command with --resume: … is kept": Case(
        fit("--checkpoint c --start 0.01").arguments, prepare=closing
    ),
    "standard output: …": Case("simulate scene.json -o -", prepare=full),
    "what was compiled could not be kept; name a folder that can be written by NUMBA_CACHE_DIR": Case(
        "warmup --small", prepare=kept_nowhere
    ),
    # checkpoints
    "--checkpoint: …: must be a file of its own, not an input or the output": fit("--checkpoint scene.json"),
    "--resume: the output is no file, so none is kept beside it; name one with --checkpoint": fit("-o - --resume"),
    "there is no such checkpoint to resume from": fit("--resume --checkpoint absent"),
    "is not a checkpoint that this clothfit can read; name another file": fit("--checkpoint good.npz"),
    "is damaged: its checksum is wrong; begin anew, without --resume": fit(
        "--resume --checkpoint c", c=b"clothfit checkpoint 1 00\n{}\n"
    ),
    "is not what a fit has written; begin anew, without --resume": fit(
        "--resume --checkpoint c", c=FORMAT + checksum(b"{}\n") + b"\n{}\n"
    ),
    "holds what no such fit has found; begin anew, without --resume": Case(RESUMED, prepare=unlikely),
    "belongs to another fit: …": fit("--resume --checkpoint c", c=encoded({"scene": "#1"}, checkpoint.NOTHING)),
    "is a pipe, which keeps nothing; name a file for the checkpoint": Case(
        fit("--checkpoint pipe").arguments, prepare=piped
    ),
    "is not a file, so there is no checkpoint to read": fit("--resume --checkpoint /dev/null"),
    # divergence
    "the simulation diverged at step … (t = … s), …; …": Case(
        "simulate scene.json", {"scene.json": HARD}
    ),
    "objects[…] diverged at step … (t = … s); try a smaller delta": Case(
        "check scene.json --target far.npz",
        {"scene.json": HARD, "far.npz": {"positions": np.zeros((60, VERTICES, 3))}},
    ),
    "the gradient overflows": patched(
        Case("check scene.json"),
        "clothfit.objective.objective.Objective.add_pullback",
        lambda *all: all[-1].fill(np.inf),
    ),
    "no values that were tried gave a simulation that stays finite; nothing is written": Case(
        "estimate scene.json --target still.npz",
        {"scene.json": GONE, "still.npz": {"positions": np.broadcast_to(STILL, (40, VERTICES, 3))}},
    ),
    "no steps that fit into the time are short enough for a reference motion; allow more of it (--budget), or fewer "
    "frames (--steps)": patched(speed("--budget 1e-9"), "clothfit.evaluation.work_precision.REFERENCE_SECONDS", 0.0),
    "the reference motion is not known well enough to judge by; allow more time (--budget)": patched(
        speed("--budget 1e-9"), "clothfit.evaluation.work_precision.KNOWN", np.inf
    ),
    "…; the horizon ends before that": Case(
        EVALUATE + "scene.json --steps 300", {"scene.json": {**HARD, "optimizationIterations": 5}}
    ),
    # ends
    "the gradient is wrong (…): a fault of the program; please report it with the scene": patched(
        Case("check scene.json"), "clothfit.objective.objective.Objective.add_pullback", lambda *all: all[-1].fill(1.0)
    ),
    "interrupted": patched(MOVE, "clothfit.simulate", raising(KeyboardInterrupt())),
    "a fault of the program: …: … (set CLOTHFIT_TRACEBACK=1 to see where)": patched(
        MOVE, "clothfit.simulate", raising(ZeroDivisionError("by nothing"))
    ),
}
"""By message. Each ends the command with the code of its row."""
