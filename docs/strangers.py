"""Write `docs/strangers.md` and the films in `docs/strangers`: `python docs/strangers.py SHOTS [NAME …]`. Needs
Pillow.

SHOTS is a folder with files of the generators in `benchmarks/shots` (`make gallery` writes it). Each shot goes through
the commands that the page shows; their figures are kept in `docs/strangers/figures.json`. `page()` alone, without
running anything, is what a test compares the page with.
"""

from __future__ import annotations

import json
import os
import resource
import shlex
import subprocess
import sys
import tempfile
from inspect import cleandoc
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

DOCS = Path(__file__).resolve().parent
PAGE, FILMS = DOCS / "strangers.md", DOCS / "strangers"
FIGURES = FILMS / "figures.json"
WIDTH = 400  # pixels of a film
HEAD = """
# Shots of other programs

Each of these motions was simulated by another program, with its own model of cloth, air and contact, and then fitted
by the same two commands as your own shot would be:

```sh
clothfit new 'shot_*.obj' --up z --fps 40 --fix-side left --pins-from 'shot_*.obj' --fit auto -o scene.json
clothfit estimate scene.json --target 'shot_*.obj' --up z --fps 40 -o fitted.json
```

Held vertices are named by their numbers; `--pins-from` is there where they move, `--sphere` where there is a ball. The
cloth is blue, the target over it translucent green. A *still picture* is the best that does not move: the mean of all
frames. The error is the root mean square distance over all vertices and frames; seconds are of the processor, with the
program's start and the intervals. `make gallery` makes the shots ([benchmarks/shots](../benchmarks/shots)), the fits
and this page; more shots are in [accuracy.md](accuracy.md).
"""


class Shot(NamedTuple):
    """A motion of another program."""

    name: str
    program: str
    title: str


SHOTS = (
    Shot("mujoco-flag", "MuJoCo 4.0", "A sheet held at an edge that waves"),
    Shot("newton-skirt", "Newton 1.8, VBD", "A skirt on a waist that turns"),
    Shot("mujoco-ball", "MuJoCo 4.0", "A sheet falls on a ball"),
    Shot("blender-wind-2", "Blender 4.5", "A sheet in Blender's wind"),
    Shot("newton-wind", "Newton 1.8, VBD", "A sheet in wind"),
    Shot("bullet-flag", "Bullet 3", "A sheet held at a waved edge, position based"),
)


def page() -> str:
    """The page, from the figures that are kept."""
    known: dict[str, Any] = json.loads(FIGURES.read_text("utf-8"))
    shown = [shot for shot in SHOTS if shot.name in known]
    rows = [row(shot, known[shot.name]) for shot in shown]
    table = "\n".join(["| shot | program | vertices, frames | still picture | as it came | fitted | seconds |",
                       "|---|---|---|---|---|---|---|", *rows])  # fmt: skip
    films = [f"## {shot.title}\n\n![{shot.title}](strangers/{shot.name}.gif)\n\n{says(shot, known[shot.name])}"
             for shot in shown]  # fmt: skip
    return "\n\n".join([cleandoc(HEAD), table, *films]) + "\n"


def row(shot: Shot, own: dict[str, Any]) -> str:
    """A row of the table."""
    lengths = [f"{1e3 * own[name]:.3g} mm" for name in ("still", "start", "error")]
    counts = f"{own['vertices']}, {own['frames']}"
    return f"| {shot.title} | {shot.program} | {counts} | {' | '.join(lengths)} | {own['seconds']:.0f} |"


def says(shot: Shot, own: dict[str, Any]) -> str:
    """What the fit says of itself."""
    verdict = {"adequate": "the model explains the shot", "differs": "the model cannot follow the shot in all",
               "fails": "the fit leaves more of the motion than it explains, and says so"}[own["verdict"]]  # fmt: skip
    share = f"{own['error'] / own['travel']:.1%} of the way that it moves"
    return f"{shot.program}. The fit ends {1e3 * own['error']:.3g} mm off, {share}; its verdict: {verdict}."


def options(arrays: Any, name: str) -> tuple[list[str], list[str]]:
    """What `new` and `estimate` are told of a shot."""
    from clothfit.formats.axes import Axes, to_scene

    x, held, up = arrays["positions"], arrays["held"], str(arrays["up"])[:1]
    reading = ["--up", up, "--fps", f"{float(arrays['fps']):g}"]
    own = ["--fix-vertices", ",".join(map(str, held.tolist()))] if len(held) else []
    if len(held) and np.ptp(x[:, held], axis=0).max() > 1e-4:
        own += ["--pins-from", f"{name}_*.obj"]
    if "ball" in arrays:
        *centre, radius = arrays["ball"].tolist()
        place = to_scene(np.array(centre), Axes(up, "right")).tolist()
        own += [f"--sphere={','.join(f'{each:g}' for each in (*place, radius))}"]
    return [*reading, *own], reading


def write_sequence(arrays: Any, name: str) -> None:
    """Write a shot as the OBJ files of its frames."""
    faces = "".join(f"f {a} {b} {c}\n" for a, b, c in (arrays["triangles"] + 1).tolist())
    for number, points in enumerate(arrays["positions"]):
        lines = "".join("v {:.9g} {:.9g} {:.9g}\n".format(*point) for point in points.tolist())
        Path(f"{name}_{number:04d}.obj").write_text(lines + faces, encoding="utf-8")


def clothfit(*words: str) -> dict[str, Any]:
    """Run a command; what it says as JSON. Its end without reaching a tolerance (5) is no failure."""
    print("$ clothfit", shlex.join(words)[:150], flush=True)
    command = [sys.executable, "-m", "clothfit", *words, "--json"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode not in (0, 5):
        raise SystemExit(done.stderr)
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def fitted(shot: Shot, path: Path) -> dict[str, Any]:
    """Fit a shot in this folder, and make its film."""
    with np.load(path) as arrays:
        count = arrays["positions"].shape[1]
        write_sequence(arrays, shot.name)
        of_scene, reading = options(arrays, shot.name)
    target = f"{shot.name}_*.obj"
    clothfit("new", target, *of_scene, "--fit", "auto", "-o", "scene.json")
    clothfit("estimate", "scene.json", "--target", target, *reading, "-o", "first.json", "--set", "max_evaluations=3")
    began = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
    found = clothfit("estimate", "scene.json", "--target", target, *reading, "-o", "fitted.json")
    seconds = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - began
    clothfit("report", "scene.json", "fitted.json", "--target", target, *reading, "-o", "film.gif")
    small(Path("film.gif"), FILMS / f"{shot.name}.gif")
    base = found["baselines"]
    return {"vertices": count, "frames": found["frames"], "still": base["still"],
            "start": base["start"], "error": found["rmse"], "travel": found["travel"], "seconds": seconds,
            "verdict": found["verdict"]["model"]}  # fmt: skip


def small(film: Path, path: Path) -> None:
    """A film with every second frame, of a small width."""
    from gallery import frames, save

    shown, durations = frames(film, WIDTH)
    save(shown[::2], [2 * each for each in durations[::2]], path)


def main() -> None:
    """Fit all shots that are there, and write their films, their figures and the page."""
    source = Path(sys.argv[1]).resolve()
    FILMS.mkdir(exist_ok=True)
    known: dict[str, Any] = json.loads(FIGURES.read_text("utf-8")) if FIGURES.exists() else {}
    for shot in SHOTS:
        if sys.argv[2:] and shot.name not in sys.argv[2:]:
            continue
        if not (path := source / f"{shot.name}.npz").exists():
            print(f"{shot.name}: is not in {source}; left as it was")
            continue
        with tempfile.TemporaryDirectory() as folder:
            os.chdir(folder)
            known[shot.name] = fitted(shot, path)
            os.chdir(DOCS)
        print(shot.name, known[shot.name], flush=True)
        FIGURES.write_text(json.dumps(known, indent=1) + "\n", encoding="utf-8")
        PAGE.write_text(page(), encoding="utf-8")


if __name__ == "__main__":
    main()
