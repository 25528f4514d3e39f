"""What a command refuses, or ends with, by family and message; see `failing`."""

from __future__ import annotations

import os
import sys
import zipfile
from typing import Any

import jsonschema
import numpy as np

from clothfit.optimise.checkpoint import FORMAT_LINE, State, checksum, encoded
from helpers.archives import archive, header, npy
from helpers.failing import (
    GOOD,
    SMALL,
    SPRINGS,
    VERTICES,
    Case,
    ending,
    fit,
    motion,
    own,
    patched,
    raising,
    scene,
    text,
)
from helpers.scenes import MISSING, changed, even, trial

EVALUATE, SPEED, TARGET = "evaluate scene.json ", "evaluate scene.json --speed ", "target scene.json "
NOTHING = trial("nn", 5)
OTHER = trial("nG", 5, nx=3)
GUSTY = trial(
    "nG", 5, fit={"windVelKeys": "L"},
    windVelKeys={"times": [0, 1], "values": [{"x": 0, "y": 0, "z": 0}, {"x": 1, "y": 0, "z": 0}]},
)  # fmt: skip
HELD = trial("nG", 5, vertIsFixed=[True] * VERTICES)
UNSEEN = {**GOOD, "observed": np.zeros((5, VERTICES), bool)}
HARD = even("nG", 60, integrationMethod=0, delta=0.004, springStiffness=[1e3] * SPRINGS)  # explicit steps are too long
GONE = even("nG", 40, integrationMethod=0, delta=1.0, damping=1e3)  # whatever its stiffness is
STILL = np.array([[p["x"], p["y"], p["z"]] for p in GONE["objects"][0]["vertPos"]])
NONE = np.zeros(0)
STATE = State(*[np.ones(1)] * 2, 1.0, np.ones(1), NONE, (), NONE, 0.0, 0, NONE, 0.0, [1.0], 0, 1.0, [])


def read_only(patch: Any) -> None:
    """The answer of a system where nothing is writable; a test that root runs could write everywhere."""
    access = os.access
    patch.setattr("clothfit.base.writing.os.access", lambda path, mode: mode & os.W_OK == 0 and access(path, mode))


def ruled(patch: Any) -> None:
    """A schema with a rule that has no words of its own; none of today's is such."""
    schema = {"properties": {"delta": {"multipleOf": 7}}}
    patch.setattr("clothfit.scene.schema.conforms", lambda *_: False)
    patch.setattr("clothfit.scene.schema._validator", lambda: jsonschema.Draft202012Validator(schema))


USAGE = {
    message: ending(2, arguments)
    for message, arguments in {
        "no such command …": "fold",
        "no such option …": "estimate scene.json --fast",
        "missing argument …": "simulate",
        "missing option …": "export scene.json",
        "got unexpected extra argument…": "simulate a.json b.json",
        "option … requires an argument": "simulate scene.json --steps",
        "option … does not take a value": "simulate scene.json --quiet=3",
        "--speed takes one scene; … does not go with it": EVALUATE + "scene.json --speed",
        "… goes with --speed only": EVALUATE + "scene.json --budget 3",
        "--jobs is for this machine; a --cluster has its own workers":
            "estimate scene.json --cluster tcp://x:1 --jobs 2",
        "--checkpoint and --resume are for fits on this machine, not on a --cluster":
            "estimate scene.json --cluster tcp://x:1 --resume",
        "standard input and output (-) are for one scene, not for …": "estimate scene.json -",
        "--checkpoint: … scenes need one each: put {stem} into the name": "estimate scene.json b.json --checkpoint c",
        "-o …: … scenes need a folder, or a name with {stem}": "estimate scene.json b.json -o c.json",
        "… is for one scene fitted from one start on this machine": "estimate scene.json --starts 2 --log x.jsonl",
        "--report is for one fit of one scene; make the pages of several with clothfit report":
            "estimate scene.json --starts 2 --report page.html",
        "--report shows the first --target, which must be of SCENE itself, without @":
            "estimate scene.json --target good.npz@scene.json --report page.html",
        "--scale, --up, --handedness, --fps, --frames and --map describe the motion of --target; add that":
            "estimate scene.json --up z",
        "… is for …; leave it out": "new plane --scale 2",
        "… and … say the same; give one of them": "new plane --delta 0.1 --fps 10",
    }.items()
}  # fmt: skip

OPTIONS = {
    "invalid value for …": Case("simulate scene.json --steps many"),
    "--steps must be at least 1; 0 was given": Case("simulate scene.json --steps 0"),
    "--starts must be at least 1; 0 was given": fit("--starts 0"),
    "tolerance must be above 0 and below 1; 1 was given": Case("simulate scene.json --tolerance 1"),
    "fps: does not go with every; each says which frames there are": Case(TARGET + "--fps 30 --every 2"),
    "objective: there is no …; use …": fit("--objective colour"),
    "method: there is no …; use …": fit("--method magic"),
    "holdout must be a fraction above 0 and below 1; 1 was given": fit("--holdout 1"),
    "start: … is not within the bounds …": fit("--start 1e9"),
    "memory: … is not a size; give one such as 200MB, 2GiB or 1.5G": fit("--memory much"),
    "--in-place writes into the scene's file; it does not go with -o or standard input": fit("--in-place -o x.json"),
    "standard input (-) can be only one of the inputs": Case("evaluate - -"),
    "a picture's name ends in …": Case(SPEED + "--plot x.gif"),
    "a picture needs …; install it with: pip install 'clothfit[plot]'": Case(
        SPEED + "--plot x.svg", prepare=lambda patch: patch.setitem(sys.modules, "matplotlib", None)
    ),
    "NUMBA_DISABLE_JIT is set, so nothing is compiled": patched(
        "warmup", "clothfit.kernels.cache.config.DISABLE_JIT", 1
    ),
    "an export is several files, which need a folder; name one with -o": Case("export scene.json --to csv -o -"),
    "no line of it is the record of a fit; give a file that estimate --log has written": Case(
        "report scene.json scene.json --log fit.jsonl", {"fit.jsonl": b"no\nlog\n"}
    ),
}

MEMORY = {
    "… frames of … vertices take …, … of memory are free; use fewer frames (--steps, --fps, optimizationIterations)":
        Case("simulate scene.json --steps 100000000000"),
    "memory: … is too little: the targets take …, and a fit of … steps of … vertices needs … in all": fit(
        "--memory 1kB"
    ),
    "memory: too little for the balance of momentum; use another method, or allow more": patched(
        fit("--method momentum"), "clothfit.optimise.momentum.fits", lambda objective: False
    ),
    "… steps of … vertices, with … velocities each, take … of memory, … are free; use fewer iterations "
    "(forwardSubSteps)": scene(("forwardSubSteps",), 2_000_000_000),
    "out of memory; try fewer frames (--steps, optimizationIterations)": ending(
        1, patched("simulate scene.json", "clothfit.simulate", raising(MemoryError()))
    ),
}  # fmt: skip

READING = {
    "there is no such file": Case("simulate absent.json"),
    "cannot be read: …": Case("simulate ."),
    "is a folder; a motion file (.npz) is needed": fit("--target ."),
    "cannot be read as .npz or .npy (…)": fit("--target bad.npz", **{"bad.npz": b"positions"}),
    "it is packed in another way than NumPy's; write it with numpy.savez": Case(
        "estimate scene.json --target bad.npz",
        {"bad.npz": archive(("positions.npy", npy(header())), method=zipfile.ZIP_LZMA)},
    ),
}

SCENES = {
    "the file is empty; a scene is a JSON object": text(b""),
    "byte … (0x…) is not … text; save the file as UTF-8": text(b'{"title": "\xe9"}'),
    "not JSON text (UTF-16 without a byte order mark?); save the file as UTF-8": text("{}".encode("utf-16-le")),
    "the text ends inside a value; is the file complete?": text(b'{"delta": '),
    "not JSON: …": text(b"{'delta': 1}"),
    "line …, column …: … is not JSON; a finite number is needed": scene(("mine",), float("nan")),
    "the JSON is nested too deeply to be a scene (more than … levels)": text(b"[" * 200_000),
    "the key … appears more than once; keep one": text(b'{"delta": 1, "delta": 2}'),
    "the key appears more than once in an object; keep one": text(b'{"a": {"x": 1, "x": 2}, "a": 3}'),
    "delta: is missing, and it has no default": scene(("delta",), MISSING),
    "title: 5 is not …": scene(("title",), 5),
    "integrationMethod: 7 is not one of …": scene(("integrationMethod",), 7),
    "delta: 0 is too small; it must be above 0": scene(("delta",), 0),
    "tolerance: 1 is too large; it must be below 1": scene(("tolerance",), 1),
    "is too large; it must be at most …": scene(("optimizationIterations",), 10**30),
    "optimizationIterations: 0 is too small; it must be at least …": scene(("optimizationIterations",), 0),
    "objects: is empty; at least … is needed": scene(("objects",), []),
    "… breaks the rule …": Case("simulate scene.json", prepare=ruled),
    "… is not two letters of n, F, R, M, G, L (masses, then stiffnesses)": own("optimizationSettings", "x"),
    "cannot be fitted; … can": scene(("fit",), {"colour": "G"}),
    "delta: … steps of … s do not end at a finite time": scene(("delta",), 1e308),
}

ARRAYS = {
    "vertPos[5].x: Infinity is not a finite number within the range of doubles": own("vertPos", 5, "x", float("inf")),
    "vertMass[3]: … is not a number": own("vertMass", 3, "heavy"),
    "vertIsFixed[2]: 1 is not true or false": own("vertIsFixed", 2, 1),
    "springs[3]: 3.5 is not an index (a whole number)": own("springs", 3, 3.5),
    "vertPos[5]: 3 is not a vector (an object with x, y and z)": own("vertPos", 5, 3),
    "vertPos[5].z: is missing; a vector needs x, y and z": own("vertPos", 5, {"x": 0, "y": 0}),
    "vertPos: is empty; an object needs at least one vertex": own("vertPos", []),
    "vertex … does not exist (the object has … vertices)": own("springs", 3, 144),
    "… indices do not make …; a multiple of … is needed": own("triangles", [0, 1, 2, 3]),
    "vertMass: … for …; one each is needed": own("vertMass", [1.0]),
    "vertMass[3]: the mass … must be above 0": own("vertMass", 3, -1),
    "vertex … is joined to itself; a spring needs two vertices": own("springs", 1, 0),
    "vertices … and … lie at the same place; a spring needs a rest length above 0": own(
        "vertPos", 1, {"x": 0, "y": 0, "z": 0}
    ),
    "vertices … and … are too far apart; the spring's rest length is not finite": own(
        "vertPos", 5, {"x": 1e300, "y": 0, "z": 0}
    ),
    "must be a list that names each of the … vertices; remove the field": Case(
        "info scene.json", {"scene.json": changed(SMALL, ("objects", 0, "meshVertices"), [0, 1])}
    ),
}

MOTIONS = {
    "positions: is missing": motion(positions=None),
    "has shape …, (frames, …, 3) fits …": motion(positions=np.zeros((5, 7, 3))),
    "times: has shape … and type …, … numbers, one per frame, fit": motion(times=np.zeros(3)),
    "times: must be finite and increasing": motion(times=np.zeros(5)),
    "positions[0, 0]: …, though not marked as unobserved": motion(positions=np.full((5, VERTICES, 3), np.nan)),
    "weights[0] must be at least 0 and finite; -1 was given": motion(weights=-np.ones(VERTICES)),
    "times[…]: … s is too many steps away": motion(times=1e9 * np.arange(5)),
}

TOGETHER = {
    "nothing to fit: no object flags anything; set its optimizationSettings, for example to 'nL', or its fit": fit(
        of=NOTHING
    ),
    "shows nothing after the start that can move, within … frames, so there is nothing to fit to": motion(
        observed=np.zeros((5, VERTICES), bool)
    ),
    "shows … frames, too few to keep some of them out of the fit": fit("--holdout 0.5", trial("nG", 2)),
    "shows too few vertices to keep some of them out of the fit": fit(
        "--holdout 0.5 --holdout-of vertices", trial("nG", 5, vertIsFixed=[i > 0 for i in range(VERTICES)])
    ),
    "objects[…] has … values of …, … are needed": fit("--start other.json", **{"other.json": OTHER}),
    "its objects have …, those of …": Case(EVALUATE + "other.json", {"other.json": OTHER}),
    "…: … in this scene, … in …; a fit of both needs as many": fit(
        "--target good.npz@other.json", GUSTY, **{"other.json": trial("nG", 5)}
    ),
    "shows no observed vertex in the first … s": Case(
        EVALUATE + "scene.json --target bad.npz", {"bad.npz": UNSEEN}
    ),
    "whether the gradient is right cannot be seen here (… of … steps are short enough and above rounding, …); try "
    "fewer or more --steps": Case("check scene.json", {"scene.json": HELD}),
}

WRITING = {
    "cannot write …: File name too long": Case(f"simulate scene.json -o {'n' * 300}"),
    "cannot write …: it is a folder": Case("simulate scene.json -o ."),
    "cannot write …: it does not name a file": Case("simulate scene.json -o absent/"),
    "cannot write …: the file is there and is not writable": Case("simulate scene.json -o good.npz", {}, read_only),
    "cannot write …: the folder … does not exist": Case("simulate scene.json -o absent/x.npz"),
    "cannot write …: the folder … is not writable": Case("simulate scene.json -o x.npz", {}, read_only),
    "cannot write …: it is an input, which is never written over; name another file": Case(
        "simulate scene.json -o scene.json"
    ),
    "cannot write …: it is an input, which is never written over": Case(
        "evaluate x.svg --speed --plot x.svg", {"x.svg": SMALL}
    ),
    "--dump must be a file of its own; - was given": Case("simulate scene.json --dump -"),
}

CHECKPOINTS = {
    "there is no such checkpoint to resume from": fit("--resume --checkpoint absent"),
    "is not a checkpoint that this clothfit can read; name another file": fit("--checkpoint good.npz"),
    "is damaged: its checksum is wrong; begin anew, without --resume": fit(
        "--resume --checkpoint c", c=b"clothfit checkpoint 5 00\n{}\n"
    ),
    "is not what a fit has written; begin anew, without --resume": fit(
        "--resume --checkpoint c", c=FORMAT_LINE + checksum(b"{}\n") + b"\n{}\n"
    ),
    "belongs to another fit: …": fit("--resume --checkpoint c", c=encoded({"scene": "#1"}, STATE)),
}

DIVERGENCE = {
    message: ending(4, case)
    for message, case in {
        "the simulation diverged at step … (t = … s), …; …": Case("simulate scene.json", {"scene.json": HARD}),
        "objects[…] diverged at step … (t = … s); try a smaller delta": Case(
            "check scene.json --target far.npz",
            {"scene.json": HARD, "far.npz": {"positions": np.zeros((60, VERTICES, 3))}},
        ),
        "the gradient overflows": patched(
            "check scene.json",
            "clothfit.objective.objective.Objective.add_pullback",
            lambda *arguments: arguments[-1].fill(np.inf),
        ),
        "no values that were tried gave a simulation that stays finite; nothing is written": Case(
            "estimate scene.json --target still.npz",
            {"scene.json": GONE, "still.npz": {"positions": np.broadcast_to(STILL, (40, VERTICES, 3))}},
        ),
        "…; the horizon ends before that": Case(
            EVALUATE + "scene.json --steps 300", {"scene.json": {**HARD, "optimizationIterations": 5}}
        ),
        "…; the frames before are shown": Case("report scene.json scene.json --steps 300", {"scene.json": HARD}),
        "no steps that fit into the time are short enough for a reference motion; allow more time (--budget) or "
        "fewer frames (--steps)": patched(
            SPEED + "--budget 1e-9", "clothfit.evaluation.work_precision.REFERENCE_SECONDS", 0.0
        ),
    }.items()
} | {
    "the reference motion is not known well enough to judge by; allow more time (--budget)": patched(
        SPEED + "--budget 1e-9", "clothfit.evaluation.work_precision.REFERENCE_MARGIN", np.inf
    )
}

MANY = {
    "--cluster needs the package distributed: install clothfit[cluster]": Case(
        "estimate scene.json --cluster tcp://x:1", prepare=lambda patch: patch.setitem(sys.modules, "distributed", None)
    ),
    "cannot make the folder …: …": fit("b.json -o scene.json/out/"),
    "… and … would both be written to …; use {folder} in -o": fit("a/scene.json -o out/", **{"a/scene.json": SMALL}),
    "… of … scenes are not valid: …": Case("validate scene.json bad.json", {"bad.json": b"{}"}),
}

ENDS = {
    "interrupted": ending(130, patched("simulate scene.json", "clothfit.simulate", raising(KeyboardInterrupt()))),
    "a fault of the program: …: … (set CLOTHFIT_TRACEBACK=1 to see where)": ending(
        1, patched("simulate scene.json", "clothfit.simulate", raising(ZeroDivisionError("by nothing")))
    ),
    "the gradient is wrong (…): a fault of the program; please report it with the scene": ending(
        1,
        patched(
            "check scene.json",
            "clothfit.objective.objective.Objective.add_pullback",
            lambda *arguments: arguments[-1].fill(1.0),
        ),
    ),
}

FAMILIES = {
    "usage": USAGE, "options": OPTIONS, "memory": MEMORY, "reading": READING, "scenes": SCENES, "arrays": ARRAYS,
    "motions": MOTIONS, "together": TOGETHER, "writing": WRITING, "checkpoints": CHECKPOINTS, "divergence": DIVERGENCE,
    "many": MANY, "ends": ENDS,
}  # fmt: skip
