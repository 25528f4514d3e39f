"""Files of other programs through every command that takes them: `python benchmarks/foreign_files.py FOLDER`.

FOLDER has the files and `expected.json`: for each name the `options` that say its axes and unit, and `refused`: null
where it is to be read, else words of the message ("any" for whichever). NAME.truth.npz has the true `positions`
(frames, n, 3), z up, right-handed, m. Each file goes through `info`, `new`, `convert` and `estimate --target` with the
scene that `new` made of it. A file is right where what `convert` gives is the truth, to 1e-5 of its size; a command may
refuse it with exit code 2 or 3 and one line that names the file. What is not so is listed; the exit code is 1 then.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import shlex
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from clothfit.base.arrays import Array
from clothfit.cli.program import run
from clothfit.formats.axes import Axes, to_scene

TRUTHS = Axes("z", "right", 1.0)
TOLERANCE = 1e-5
"""Of the size: text has six digits in many programs."""


def called(command: str) -> tuple[int, str]:
    """The exit code of a command, and the last line that it says."""
    err = io.StringIO()
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(err):
        code = run(shlex.split(command))
    text = err.getvalue()
    if "Traceback" in text:
        return 1, text
    return code, text.strip().splitlines()[-1] if text.strip() else ""


def distance(found: Array, truth: Array) -> float:
    """The largest distance of a point, as a share of the size; of another number of points to the nearest (STL)."""
    size = float(np.linalg.norm(np.ptp(truth.reshape(-1, 3), axis=0)))
    if len(found) != len(truth):
        return np.inf
    if found.shape == truth.shape:
        gaps = np.linalg.norm(found - truth, axis=2)
        if gaps.max() <= TOLERANCE * size:
            return float(gaps.max()) / size
    apart = np.linalg.norm(found[0][:, None] - truth[0][None], axis=2)
    return float(max(apart.min(axis=0).max(), apart.min(axis=1).max())) / size if len(truth) == 1 else np.inf


def wrong(folder: Path, name: str, expected: dict[str, Any], work: Path) -> list[str]:
    """What is not as it should be with a file."""
    path, options, refused = shlex.quote(str(folder / name)), expected["options"], expected["refused"]
    commands = {
        "info": f"info {path}",
        "new": f"new {path} {options.replace('--handedness right', '')} --fix-side top -o {work}/s.json",
        "convert": f"convert {path} {work}/out.npz {options}",
        "estimate": f"estimate {work}/s.json --target {path} {options} --max-evaluations 2 -o {work}/f.json",
    }
    for old in work.iterdir():
        old.unlink()
    found: list[str] = []
    said: dict[str, tuple[int, str]] = {}
    for command, line in commands.items():
        if command == "estimate" and not (work / "s.json").exists():
            continue
        code, text = said[command] = called(line)
        if code not in (0, 2, 3, 5) or (
            code in (2, 3) and not (text.startswith("error: ") and Path(name).stem.strip("*") in text)
        ):
            found.append(f"{command}: {code}: {text}")
    code, text = said["convert"]
    if refused is None and code:
        found.append(f"convert refuses it: {text}")
    if refused is not None and (not code or (refused != "any" and refused not in text)):
        found.append(f"convert says not {refused!r}: {code}: {text}")
    truth = folder / f"{name.replace('*', '_')}.truth.npz"
    if code == 0 and truth.exists():
        with np.load(truth) as arrays, np.load(work / "out.npz") as converted:
            gap = distance(converted["positions"], to_scene(arrays["positions"], TRUTHS))
        if gap > TOLERANCE:
            found.append(f"convert is {gap:.2g} of the size off")
    if "-v" in sys.argv:
        print(name, *(f"{command} {code}: {text}" for command, (code, text) in said.items()), sep="\n    ")
    return found


def main(folder: Path) -> int:
    """Print the table; the number of files with something wrong, at most 1."""
    expected = json.loads((folder / "expected.json").read_text("utf-8"))
    bad = 0
    with tempfile.TemporaryDirectory() as work:
        os.environ["COLUMNS"] = "1000"
        for name in sorted(expected):
            faults = wrong(folder, name, expected[name], Path(work))
            bad += bool(faults)
            for fault in faults:
                print(f"{name}: {fault}", flush=True)
    print(f"{len(expected)} files, {bad} with something wrong")
    return min(bad, 1)


if __name__ == "__main__":
    if len(sys.argv) < 2:
        sys.exit(__doc__)
    sys.exit(main(Path(sys.argv[1])))
