"""Cases: a command, a hostile file for it, and what came of it. Commands run in this process, as the program runs them.

Simulations are of two steps, fits of a few evaluations, so that a case takes milliseconds.
"""

import contextlib
import io
import json
import os
import re
import time
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from random import Random

import numpy as np
from helpers.files import damaged

from clothfit.base.checkpoint import archived, opened
from clothfit.cli.program import run
from fuzz.mutations import KEYED, KINDS, TABLE, motion, moving, scene, text_bytes, with_token

CODES = (0, 3, 4, 5)
"""The exit codes that a file can lead to: done, invalid, diverged, not converged."""

SLOW = 5.0  # s
LONGEST = 400  # characters of a message

FIT = ("--max-evaluations", "5", "--no-intervals", "-o", "out.json")
COMMANDS = {
    "scene": [
        ("simulate", "{file}", "--steps", "2", "-o", "out.npz"),
        ("simulate", "{file}", "--steps", "2", "-o", "out.npz", "--json"),
        ("target", "{file}", "--steps", "2", "--fps", "70", "-o", "out.npz"),
        ("evaluate", "good.json", "{file}", "--steps", "3"),
        ("evaluate", "{file}", "good.json", "--steps", "3", "--target", "good.npz"),
        ("info", "{file}"),
    ],
    "motion": [
        ("evaluate", "good.json", "good.json", "--steps", "3", "--target", "{file}"),
    ],
    "foreign": [
        ("evaluate", "good.json", "good.json", "--steps", "3", "--target", "{file}", "-q"),
        ("convert", "{file}", "out.mdd", "-q"),
        ("convert", "{file}", "out.npz", "--scene", "good.json", "--frames", ":1", "-q"),
        ("info", "{file}"),
        ("new", "{file}", "-o", "made.json", "-q"),
    ],
    "moving": [
        ("simulate", "{file}", "--steps", "2", "-o", "out.npz"),
        ("simulate", "{file}", "--steps", "2", "-o", "out.npz", "--energy"),
        ("evaluate", "keyed.json", "{file}", "--steps", "3"),
        ("info", "{file}"),
    ],
    "keys": [
        ("simulate", "keyed.json", "--steps", "2", "-o", "out.npz"),
        ("info", "keyed.json"),
    ],
    "checkpoint": [
        ("estimate", "good.json", "--target", "good.npz", "--resume", "--checkpoint", "{file}", *FIT),
    ],
}
FITS = {
    "scene": [
        ("estimate", "{file}", "--target", "good.npz", *FIT),
        ("estimate", "good.json", "--target", "good.npz@{file}", *FIT),
        ("estimate", "good.json", "--target", "good.npz", "--start", "{file}", *FIT),
    ],
    "moving": [("estimate", "{file}", "--target", "good.npz", *FIT), ("check", "{file}", "--steps", "3")],
    "motion": [("estimate", "good.json", "--target", "{file}", *FIT)],
}
"""Commands that take longer, tried more rarely."""


BLENDER = Path(__file__).parents[1] / "formats" / "blender"
SUFFIXES = {"scene": ".json", "moving": ".json", "motion": ".npz", "keys": ".csv", "checkpoint": ".checkpoint"}
TEXTS = (".obj", ".trc", ".csv", ".gltf")
WRITTEN = (*TEXTS, ".pc2", ".mdd", ".glb", ".c3d")
BLENDERS = {".abc": ["sheet.abc"], ".stl": ["sheet-binary.stl", "sheet-text.stl"]}
FOREIGN = (*WRITTEN, *BLENDERS)
"""Suffixes of motions of other programs; there is a good file of each, where this program does not write it of Blender.
USD, in a process of its own, is slow.
"""


@dataclass(frozen=True)
class Case:
    """A command with the name of its hostile file, and that file's content."""

    kind: str
    arguments: tuple[str, ...]
    data: bytes
    suffix: str = ""  # where the kind does not say it


@dataclass(frozen=True)
class Verdict:
    """What came of a case."""

    code: int
    seconds: float
    message: str  # what was said on standard error
    faults: tuple[str, ...]  # what must not be; none in a good program


@contextlib.contextmanager
def workplace(folder: str, warm: bool = True) -> Iterator[None]:
    """Work in a folder with the valid files that the commands need; `warm`: with everything compiled."""
    before = os.getcwd()
    os.chdir(folder)
    try:
        Path("good.json").write_text(json.dumps(scene()))
        Path("keyed.json").write_text(json.dumps(moving()).replace(KEYED, "case.csv"))
        Path(KEYED).write_text(TABLE)
        np.savez("good.npz", **motion())  # type: ignore[arg-type]
        np.savez("whole.npz", positions=motion()["positions"][:1])
        for suffix in WRITTEN:
            judged(("convert", "whole.npz", f"good{suffix}", "--fps", "50", "--scene", "good.json"))
        arguments = ("estimate", "good.json", "--target", "good.npz", "--checkpoint", "good.checkpoint", *FIT)
        if warm:  # compiling is not what is timed
            judged(("warmup",))
            warm_what_moves()
        judged(arguments)
        yield  # the fit ended at the limit of evaluations, so its checkpoint is still there
    finally:
        os.chdir(before)


def warm_what_moves() -> None:
    """Compile what scenes need in which something moves; in a workplace."""
    Path("case.csv").write_text(TABLE)
    whole = json.loads(Path("keyed.json").read_text())
    for method in range(4):
        Path("method.json").write_text(json.dumps({**whole, "integrationMethod": method}))
        judged(("simulate", "method.json", "--steps", "2", "-o", "out.npz", "--energy"))
        judged(("estimate", "method.json", "--target", "good.npz", *FIT))


def case(chance: Random, moving: bool = True) -> Case:
    """A case by chance, also of scenes in which something is `moving`; in a workplace."""
    shares = {"scene": 55, "motion": 33, "foreign": 10, "checkpoint": 2}
    shares |= {"moving": 50, "keys": 5} if moving else {}
    kind = chance.choices(list(shares), list(shares.values()))[0]
    if kind == "foreign":
        suffix = chance.choice(FOREIGN)
        return Case(kind, chance.choice(COMMANDS[kind]), foreign_bytes(chance, suffix), suffix)
    data = checkpoint_bytes(chance) if kind == "checkpoint" else KINDS[kind](chance)
    commands = FITS[kind] if kind in FITS and chance.random() < 0.05 else COMMANDS[kind]
    return Case(kind, chance.choice(commands), data)


def foreign_bytes(chance: Random, suffix: str) -> bytes:
    """A damaged motion of another program; of a text, often one with another word in it."""
    file = BLENDER / chance.choice(BLENDERS[suffix]) if suffix in BLENDERS else Path(f"good{suffix}")
    data = file.read_bytes()
    text = suffix in TEXTS or file.stem.endswith("text")
    return text_bytes(chance, data) if text else damaged(data, chance)


def checkpoint_bytes(chance: Random) -> bytes:
    """A damaged checkpoint, often with the checksum that belongs to the damage."""
    data = Path("good.checkpoint").read_bytes()
    if chance.random() < 0.3:
        return damaged(data, chance)
    head, held = opened("fit", data)
    about = head.partition(b"\n")[2]
    about = with_token(chance, about) if chance.random() < 0.5 else damaged(about, chance)
    return archived("fit", about, held)


def tried(one: Case, slow: float = SLOW) -> Verdict:
    """Do a case; in a workplace. More than `slow` seconds are a fault."""
    name = f"case{one.suffix or SUFFIXES[one.kind]}"
    Path(name).write_bytes(one.data)
    return judged(tuple(argument.replace("{file}", name) for argument in one.arguments), slow)


def judged(arguments: tuple[str, ...], slow: float = SLOW) -> Verdict:
    """Run a command and look at how it ends."""
    out, error = (io.TextIOWrapper(io.BytesIO(), "utf-8", "backslashreplace", write_through=True) for _ in range(2))
    raised, code = "", -1
    began = time.perf_counter()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(error), warnings.catch_warnings():
        warnings.simplefilter("always")
        try:
            code = run(list(arguments))
        except BaseException as exception:  # the very thing that must not be
            raised = f"{type(exception).__name__}: {exception}"
            if isinstance(exception, KeyboardInterrupt):
                raise
    seconds = time.perf_counter() - began
    text = error.buffer.getvalue().decode("utf-8", "replace")  # type: ignore[attr-defined]
    late = [f"more than {slow:g} s"] if seconds > slow else []
    return Verdict(code, seconds, text, (*faults(code, text, raised), *late))


READ = re.compile(r"[^:]+: [^,]+, \d+ frames? of \d+ points?, ")
"""A line on what was read of a motion, before something else is wrong."""


def faults(code: int, text: str, raised: str) -> Iterator[str]:
    """What must not be."""
    lines = text.splitlines()
    errors = [line for line in lines if line.startswith("error: ")]
    if raised or "Traceback" in text or "fault of the program" in text:
        yield f"traceback: {raised or lines[-1]}"
    elif code not in CODES:
        yield f"exit code {code}"
    if len(errors) != (code not in (0, 5)):
        yield f"{len(errors)} errors told at exit code {code}"
    said = [line for line in lines if not (line.startswith("warning: ") or READ.match(line))]
    if code == 3 and len(said) != 1:
        yield f"{len(lines)} lines for an invalid input"
    if any(len(line) > LONGEST for line in lines):
        yield f"a line of {max(map(len, lines))} characters"
    if ".py:" in text:
        yield "a warning of a library"
