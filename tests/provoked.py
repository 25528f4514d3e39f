"""What provokes each error of `docs/errors.md`, by its message: commands, calls from Python, or another test.

A command runs in a folder with `scene.json` (4 × 4 vertices, one mass to fit, 5 frames), `good.npz` (its motion) and
whatever `Case` adds.
"""

from __future__ import annotations

import io
import os
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scenes import MISSING, changed, even, trial

import clothfit
from clothfit import fit_methods, precision
from clothfit.scene import load

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


def read_only(patch: Any) -> None:
    """The answer of a system where nothing is writable; a test that root runs could write everywhere."""
    access = os.access
    patch.setattr("clothfit.output.os.access", lambda path, mode: mode & os.W_OK == 0 and access(path, mode))


MOVE, EVALUATE, TARGET = Case("simulate scene.json"), "evaluate scene.json ", "target scene.json "
NOTHING = trial("nn", 5)
HARD = even("nG", 60, integrationMethod=0, delta=0.004, springStiffness=[1e3] * SPRINGS)  # explicit steps are too long
PLACE = {"x": 0, "y": 0, "z": 0}
FAR = {"x": 1e300, "y": 0, "z": 0}
OTHER = trial("nG", 5, nx=3)
DEEP = b"[" * 200_000

COMMANDS: dict[str, Case] = {
    # usage
    "no such command …": Case("fold"),
    "no such option …": fit("--fast"),
    "missing argument …": Case("simulate"),
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
    "--steps: … is not possible, at least 1 is": Case("simulate scene.json --steps 0"),
    "--max-evaluations: … is not possible, at least 1 is": fit("--max-evaluations 0"),
    "--rmse: … m is not possible, 0 or more is": fit("--rmse -1"),
    "--…: … is not possible, at least … is": fit("--starts 0"),
    "… is not possible, it must be above 0 and finite": speed("--error 0"),
    "--in-place writes into the scene's file; it does not go with -o or standard input": fit("--in-place -o x.json"),
    "--objective: … is given twice": fit("--objective velocity --objective velocity=2"),
    "--objective: …: the weight is not a number, as in …=0.01": fit("--objective velocity=much"),
    "objective: there is no …; use …": fit("--objective colour"),
    "objective: …: a weight of … is not possible, above 0 and finite is": fit("--objective position=0"),
    "loss: there is no …; use …": fit("--loss total"),
    "loss scale: the linear loss has none; choose the loss soft_l1 or huber with it": fit("--loss-scale 0.1"),
    "loss scale: … m is not possible, it must be above 0 and finite": fit("--loss huber --loss-scale 0"),
    "tolerance: … is not possible, it must be above 0 and below 1": Case("simulate scene.json --tolerance 1"),
    "noise: … m is not possible, 0 or more is": Case(TARGET + "--noise -1"),
    "observed: the fraction … is not possible, it must be above 0 and at most 1": Case(TARGET + "--observed 0"),
    "every: … is not possible, 1 or more is": Case(TARGET + "--every 0"),
    "fps: … frames per second are not possible, the rate must be above 0 and finite": Case(TARGET + "--fps inf"),
    "fps: does not go with every; each says which frames there are": Case(TARGET + "--fps 30 --every 2"),
    "method: there is no …; use …": fit("--method magic"),
    "prior: … is not possible; give auto, none, or a width in log parameters above 0": fit("--prior -1"),
    "holdout: there is nothing called … to keep out; use …": fit("--holdout 0.2 --holdout-of springs"),
    "holdout: the fraction … is not possible, it must be above 0 and below 1": fit("--holdout 1"),
    "start: … is not within the bounds …": fit("--start 1e9"),
    "memory: … is not a size; give one such as 200MB, 2GiB or 1.5G": fit("--memory much"),
    "memory: … is not possible; a size above 0, such as 200MB, is": fit("--memory 0"),
    "a picture's name ends in .png, .svg or .pdf": speed("--plot x.gif"),
    "pictures need matplotlib: pip install matplotlib, or clothfit with its extra: pip install '.[plot]'": Case(
        speed("--plot x.svg").arguments, {}, lambda patch: patch.setitem(sys.modules, "matplotlib", None)
    ),
    "standard input (-) can be only one of the inputs": Case("evaluate - -"),
    "NUMBA_DISABLE_JIT is set, so nothing is ever compiled": patched(
        Case("warmup"), "clothfit.kernel_cache.config.DISABLE_JIT", 1
    ),
    # memory
    "… frames of … vertices take …, … of memory are free; use fewer frames (--steps, --fps, optimizationIterations)":
        Case("simulate scene.json --steps 100000000000"),
    "memory: … is too little: the targets take …, and a fit of … steps of … vertices needs … in all": fit(
        "--memory 1kB"
    ),
    "out of memory; try fewer frames (--steps, optimizationIterations)": patched(
        MOVE, "clothfit.simulate", raising(MemoryError())
    ),
    # reading
    "cannot be read: …": Case("simulate absent.json"),
    "there is no such file": fit("--target absent.npz"),
    "is a folder, a motion file (.npz) is needed": fit("--target ."),
    "cannot be read as .npz or .npy (…)": fit("--target scene.json"),
    # text
    "the file is empty; a scene is a JSON object": text(b""),
    "byte … (0x…) is not … text; save the file as UTF-8": text(b'{"title": "\xe9"}'),
    "not JSON text (UTF-16 without a byte order mark?); save the file as UTF-8": text("{}".encode("utf-16-le")),
    "the text ends inside a value; is the file complete?": text(b'{"delta": '),
    "not JSON: …": text(b"{'delta': 1}"),
    "line …, column …: … is not JSON; a finite number is needed": scene(("mine",), float("nan")),
    "the JSON is nested too deeply to be a scene": text(DEEP),
    "the key … appears more than once; keep one": text(b'{"delta": 1, "delta": 2}'),
    "the key appears more than once in an object; keep one": text(b'{"a": {"x": 1, "x": 2}, "a": 3}'),
    # scene
    "is missing, and it has no default": scene(("delta",), MISSING),
    "… is not …": scene(("delta",), "short"),
    "… is not one of …": scene(("integrationMethod",), 7),
    "… is too small; it must be above …": scene(("delta",), 0),
    "… is too large; it must be below …": scene(("tolerance",), 1),
    "… is too small; it must be at least …": scene(("optimizationIterations",), 0),
    "is empty; at least … is needed": scene(("objects",), []),
    "… is not two letters of n, G, L (masses, then stiffnesses)": own("optimizationSettings", "x"),
    "cannot be fitted; … can": scene(("fit",), {"colour": "G"}),
    "… is not a finite number": own("vertPos", 5, "x", float("inf")),
    "… is not a finite number within the range of doubles": scene(("delta",), float("inf")),
    "… within the range of doubles": own("vertMass", 3, float("nan")),
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
    "is missing": motion(positions=None),
    "has type …, numbers are needed": motion(positions=np.full((5, VERTICES, 3), "a")),
    "has shape …, (frames, …, 3) fits …": motion(positions=np.zeros((5, 7, 3))),
    "is …, the scene has …": motion(vertex_counts=np.array([7])),
    "needs … numbers, one per frame": motion(times=np.zeros(3)),
    "must be finite and increasing": motion(times=np.zeros(5)),
    "has shape … and type …, (…, …) bool fits": motion(observed=np.ones((5, 7), bool)),
    "…, though not marked as unobserved": motion(positions=np.full((5, VERTICES, 3), np.nan)),
    "weights: has shape … and type …, …": motion(weights=np.ones(3)),
    "weights…: … is not possible, it must be 0 or more and finite": motion(weights=-np.ones(VERTICES)),
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
        EVALUATE + "scene.json --target bad.npz", {"bad.npz": {**GOOD, "observed": np.zeros((5, VERTICES), bool)}}
    ),
    "… and … would both be written to …; use {folder} in -o": fit("a/scene.json -o out/", **{"a/scene.json": SMALL}),
    # writing
    "cannot write …: …": Case(f"simulate scene.json -o {'n' * 300}"),
    "it is a folder": Case("simulate scene.json -o ."),
    "it does not name a file": Case("simulate scene.json -o absent/"),
    "the file is there and is not writable": Case("simulate scene.json -o good.npz", {}, read_only),
    "the folder … does not exist": Case("simulate scene.json -o absent/x.npz"),
    "the folder … is not writable": Case("simulate scene.json -o x.npz", {}, read_only),
    "cannot write …: it is an input, which is never written over; name another with -o": Case(
        "simulate scene.json -o scene.json"
    ),
    "cannot write …: it is an input, which is never written over": Case(
        "evaluate x.svg --speed --plot x.svg", {"x.svg": SMALL}
    ),
    "--dump: … is not possible, a file of its own is needed": Case("simulate scene.json --dump -"),
    "cannot write …: it is an input, which is never written over; leave it out, or name a folder with -o": fit(
        "scene.fitted.json", **{"scene.fitted.json": SMALL}
    ),
    "cannot make the folder …: …": fit("b.json -o scene.json/out/"),
    "a motion is not text, so it is not written to a terminal; name a file with -o": patched(
        Case("simulate scene.json -o -"), "sys.stdout.isatty", lambda: True
    ),
    # checkpoints
    "--checkpoint: …: must be a file of its own, not an input or the output": fit("--checkpoint scene.json"),
    "--resume: the output is no file, so none is kept beside it; name one with --checkpoint": fit("-o - --resume"),
    "there is no such checkpoint to resume from": fit("--resume --checkpoint absent"),
    "is not a checkpoint that this clothfit can read; name another file": fit("--checkpoint good.npz"),
    "is damaged: its checksum is wrong; begin anew, without --resume": fit(
        "--resume --checkpoint c", c=b"clothfit checkpoint 1 00\n{}\n"
    ),
    "is not a file, so there is no checkpoint to read": fit("--resume --checkpoint /dev/null"),
    # divergence
    "the simulation diverged at step … (t = … s), …; …": Case(
        "simulate scene.json", {"scene.json": HARD}
    ),
    "…; the horizon ends before that": Case(
        EVALUATE + "scene.json --steps 300", {"scene.json": {**HARD, "optimizationIterations": 5}}
    ),
    # ends
    "interrupted": patched(MOVE, "clothfit.simulate", raising(KeyboardInterrupt())),
    "a fault of the program: …: … (set CLOTHFIT_TRACEBACK=1 to see where)": patched(
        MOVE, "clothfit.simulate", raising(ZeroDivisionError("by nothing"))
    ),
}
"""By message. Each ends the command with the code of its row."""

SCENE = load(SMALL)

PYTHON: dict[str, Callable[[], object]] = {
    "budget: … evaluations are too few, at least 1 is needed": lambda: clothfit.estimate(SCENE, budget=0),
    "evaluations: … is not possible, at least 1 is": lambda: fit_methods.compare_methods(SCENE, evaluations=0),
    "frames: … is not possible, at least 1 is (the initial state)": lambda: clothfit.simulate(SCENE, 0),
    "frames: … is too few to compare, at least 2 are needed": lambda: clothfit.evaluate(SCENE, SCENE, frames=1),
    "seconds: … is not possible, it must be above 0 and finite": lambda: precision.work_precision(SCENE, seconds=0),
    "… is not possible, at least … is needed": lambda: clothfit.estimate_many([SCENE], starts=0),
    "targets: … are given for … scenes; give one item for each": lambda: clothfit.estimate_many([SCENE], []),
    "target: none is given; at least one motion is needed": lambda: clothfit.estimate(SCENE, []),
    "objective: none is given; use one or more of …": lambda: clothfit.estimate(SCENE, objective={}),
    "resume: a checkpoint is needed, the file to resume from": lambda: clothfit.estimate(SCENE, resume=True),
    "start: … is not a number, an array of numbers or a scene": lambda: clothfit.estimate(SCENE, start="a"),
    "start: … values given, … has … parameters": lambda: clothfit.estimate(SCENE, start=[1.0, 2.0]),
    "parameters: shape … given, … has (…,)": lambda: clothfit.with_parameters(SCENE, [1.0, 2.0]),
    "objects: … for … objects; one each is needed": lambda: SCENE.with_values([], []),
    "… items for … objects are given": lambda: SCENE.with_values([1], [1], drag=[]),
    "there is no kind …; there are …": lambda: SCENE.with_values([1], [1], colour=[1]),
    "an array of … of shape … is not …": lambda: SCENE.with_values([np.ones(2)], [np.ones(SPRINGS)]),
    "the text holds half a surrogate pair; save it as UTF-8": lambda: clothfit.load(io.StringIO('{"a": "\ud800"}')),
    "its objects have … vertices, those of …": lambda: clothfit.estimate(SCENE, clothfit.simulate(load(OTHER))),
}
"""Errors of the library that no command comes to."""
