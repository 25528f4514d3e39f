"""Write the gallery, `docs/gallery.md` and the films in `docs/gallery`: `python docs/gallery.py`. Needs Pillow.

Each film is made by the commands that the page shows under it, in a folder beside the examples; two that stand side by
side are made smaller.
`page()` alone, without running anything, is what a test compares the page with.
"""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from inspect import cleandoc
from pathlib import Path
from typing import NamedTuple

from PIL import Image, ImageDraw, ImageFont, ImageSequence

from clothfit.cli.common.options import wrapped
from clothfit.cli.program import run
from clothfit.pictures.gif import GIF_INK, palette
from clothfit.pictures.picture_file import GROUND

DOCS = Path(__file__).resolve().parent
PAGE, FILMS = DOCS / "gallery.md", DOCS / "gallery"
WIDTH, HALF = 640, 430  # pixels of a film, and of one of two side by side
LEGEND = 0.053  # of its width: the height at the top where it says who is who and what time it is
CLOCK = (0.85, 0.062)  # of its width: where the time begins, and down to where its digits reach
COLUMNS = 96  # of a command
HEAD = """
# Gallery

`python docs/gallery.py` writes this page and runs the commands under each film. The cloth is blue; the target over it
is translucent green; where both coincide the picture is teal. Red dots are held vertices, or the border of where many
are held; what is grey are colliders. The shirt is a mesh that [examples/garments.py](../examples/garments.py) makes;
yours come from a garment tool. The scenes in which pins, colliders and the wind move are in
[examples/world](../examples/world/README.md). `clothfit report` [plays such motions in 3-D and draws them](report.md).
"""


class Film(NamedTuple):
    """A part of the gallery."""

    name: str
    title: str
    text: str
    commands: tuple[str, ...]
    captions: tuple[tuple[str, str], ...] = ()  # of several films side by side: files and what is written above them


MESHES, WORLD, KEYFRAMES = "python examples/garments.py", "examples/world", "examples/keyframes"
PEGS = (
    "--set fix_box=-0.24,0.65,-0.1:-0.18,0.8,0.1 --set fix_box=0.18,0.65,-0.1:0.24,0.8,0.1 --wind 0.5,0,1.6 --drag air "
    "--set damping=0.3"
)

SHIRT = Film(
    "shirt",
    "A shirt on a line, before and after",
    "1,408 vertices, 8,184 springs, held by two pegs in a breeze. The cache takes the place of another tool's: a soft "
    "fabric, which the fit does not know. It starts from a stock fabric, 73 mm off, and finds one factor on all "
    "stiffnesses, 3 µm off.",
    (
        MESHES,
        f"new shirt.obj {PEGS} --stiffness 12 -o theirs.json",
        "simulate theirs.json -o shirt.pc2",
        f"new shirt.obj {PEGS} --fit nF -o shirt.json",
        "evaluate shirt.json shirt.json --target shirt.pc2 --set gif=guess.gif",
        "estimate shirt.json --target shirt.pc2 --set rmse=1e-4 -o fitted.json --set gif=fit.gif",
    ),
    (("guess.gif", "first guess"), ("fit.gif", "after the fit")),
)
CURTAIN = Film(
    "curtain",
    "A curtain, before and after",
    "The walk of [the first page](../README.md#a-five-minute-walk): a first guess of the fabric, 529 mm off the shot, "
    "and the fit, 2.7 nm off.",
    (
        "new plane --size 2 --upright --fix-vertices 132,143 --stiffness 12 --set damping=0.5 --wind 1,0,3 --drag air "
        "--fit nL -o theirs.json",
        "simulate theirs.json -o 'shot_*.obj'",
        "new 'shot_*.obj' --fix-vertices 132,143 --set damping=0.5 --wind 1,0,3 --drag air --fit nL -o curtain.json",
        "evaluate curtain.json curtain.json --target 'shot_*.obj' --set gif=guess.gif",
        "estimate curtain.json --target 'shot_*.obj' --set rmse=1e-4 -o fitted.json --set gif=fit.gif",
    ),
    (("guess.gif", "first guess"), ("fit.gif", "after the fit")),
)


def example(name: str, title: str, text: str) -> Film:
    """The fit of one of the examples."""
    return Film(name, title, text, (f"estimate examples/{name}.json -o {name}.fitted.json --set gif={name}.gif",))


def world(name: str, title: str, text: str, scene: str, *more: str) -> Film:
    """The motion of a scene in which the world moves, and its fit."""
    return Film(name, title, text, (f"simulate {WORLD}/{scene}.json -q -o {scene}.npz --set gif={name}.gif", *more))


GALLERY = (
    SHIRT,
    world(
        "cape",
        "A cape on a walking figure",
        "Nine capsules walk by keys of their own; the collar is pinned to the shoulders, and the cloth rubs on the "
        "figure and on the arms that swing.",
        "cape",
    ),
    world(
        "layers",
        "A shirt over a skirt",
        "The form turns to and fro, and takes the waist of the skirt along. The shirt lies on its shoulders and on the "
        "skirt: cloths of one scene touch each other, with friction, where `selfCollision` asks for it.",
        "layers",
    ),
    world(
        "tablecloth",
        "A tablecloth, laid on askew",
        "It falls on a box, not in its middle, and slides until friction holds it.",
        "tablecloth",
    ),
    CURTAIN,
    world(
        "gusts",
        "A flag in gusts",
        "The wind comes from a table, ten times a second. The fit sees the flag alone, and finds the 17 vectors of the "
        "wind: 0.03 nm off its motion.",
        "flag",
        f"estimate {WORLD}/calm.json --target flag.npz -o found.json",
    ),
    Film(
        "drawn",
        "A curtain drawn by two handles into given folds",
        "The key, in translucent green, is how the curtain is to hang at 2 s. `clothfit control` finds paths of its "
        "two corners that bring it there to 5 mm; without them it is 163 mm away.",
        (
            f"control {KEYFRAMES}/curtain.json --keyframes {KEYFRAMES}/curtain.keys.json --handles 132,143 "
            "--budget 30s --save drawn.json --set gif=drawn.gif",
        ),
    ),
    example(
        "corners",
        "Held at four corners: 144 masses",
        "A trial: the fit recovers the hidden mass of each vertex from the motion alone.",
    ),
)


def page() -> str:
    """The page."""
    return "\n\n".join([cleandoc(HEAD), *(part for film in GALLERY for part in chapter(film))]) + "\n"


def chapter(film: Film) -> Iterator[str]:
    """The paragraphs on one film."""
    yield f"## {film.title}"
    yield f"![{film.title}](gallery/{film.name}.gif)"
    yield film.text
    lines = (line for command in film.commands for line in wrapped(typed(command), COLUMNS))
    yield "\n".join(["```sh", *lines, "```"])


def typed(command: str) -> str:
    """A command as it is typed."""
    return command if command == MESHES else f"clothfit {command}"


def shoot(film: Film) -> list[Path]:
    """Run the commands of a film in this folder: the files that it is made of."""
    for command in film.commands:
        words = shlex.split(command)
        code = subprocess.run([sys.executable, *words[1:]], check=False).returncode if command == MESHES else run(words)
        if code not in ((0, 5) if words[0] == "control" else (0,)):  # 5: a key is missed by more than 1 mm
            raise SystemExit(f"{typed(command)} failed")
    return [Path(name) for name, _ in film.captions] or [Path(f"{film.name}.gif")]


def frames(path: Path, width: int) -> tuple[list[Image.Image], list[int]]:
    """The frames of a GIF, of that width, and for how long each is shown, ms."""
    with Image.open(path) as film:
        size = (width, round(film.height * width / film.width))
        shown = [(one.convert("RGB"), int(one.info["duration"])) for one in ImageSequence.Iterator(film)]
    return [one.resize(size, Image.Resampling.BOX) for one, _ in shown], [duration for _, duration in shown]


def beside(parts: list[list[Image.Image]], captions: list[str]) -> list[Image.Image]:
    """Films side by side, in place of the legend what each is: that of a guess would say "fitted"."""
    font = ImageFont.load_default(20)
    width, cut, top = parts[0][0].width, round(LEGEND * parts[0][0].width), 34
    height = max(one[0].height for one in parts) - cut
    sheets = []
    for shown in zip(*parts, strict=True):
        sheet = Image.new("RGB", (width * len(shown), height + top), GROUND)
        for column, (one, caption) in enumerate(zip(shown, captions, strict=True)):
            sheet.paste(one.crop((0, cut, *one.size)), (column * width, top))
            rest = (round((column + CLOCK[0]) * width), top, (column + 1) * width, top + round(CLOCK[1] * width) - cut)
            ImageDraw.Draw(sheet).rectangle(rest, fill=GROUND)
            ImageDraw.Draw(sheet).text(((column + 0.5) * width, 19), caption, font=font, fill=GIF_INK, anchor="mm")
        sheets.append(sheet)
    return sheets


def save(shown: list[Image.Image], durations: list[int], path: Path) -> None:
    """Write a looping GIF whose frames share a palette."""
    colours = palette(shown)
    first, *rest = (one.quantize(palette=colours, dither=Image.Dither.NONE) for one in shown)
    first.save(path, "GIF", save_all=True, append_images=rest, duration=durations, loop=0, optimize=True, disposal=1)


def write(film: Film, path: Path) -> None:
    """Run the commands of a film in this folder and write it; a film alone is as the program has written it."""
    made, captions = shoot(film), [caption for _, caption in film.captions]
    if not captions:
        shutil.copy(made[0], path)
        return
    parts = [frames(part, HALF) for part in made]
    save(beside([one for one, _ in parts], captions), parts[0][1], path)


def main() -> None:
    """Write the page and all films."""
    FILMS.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        shutil.copytree(DOCS.parent / "examples", Path(folder) / "examples")
        os.chdir(folder)
        for film in GALLERY:
            print(film.name, flush=True)
            write(film, FILMS / f"{film.name}.gif")
        os.chdir(DOCS)
    PAGE.write_text(page(), encoding="utf-8")


if __name__ == "__main__":
    main()
