"""Write the gallery, `docs/gallery.md` and the films in `docs/gallery`: `python docs/gallery.py`. Needs Pillow.

Each film is made by the commands that the page shows under it, in a folder beside the examples, and then made smaller.
`page()` alone, without running anything, is what a test compares the page with.
"""

from __future__ import annotations

import os
import shlex
import shutil
import tempfile
from collections.abc import Iterator
from inspect import cleandoc
from pathlib import Path
from typing import NamedTuple

from PIL import Image, ImageDraw, ImageFont, ImageSequence

from clothfit.cli.common.help import wrapped
from clothfit.cli.program import run
from clothfit.pictures.gif import GIF_INK, palette
from clothfit.pictures.palette import GROUND

DOCS = Path(__file__).resolve().parent
PAGE, FILMS = DOCS / "gallery.md", DOCS / "gallery"
WIDTH = 320  # pixels of a film
LEGEND = 17  # of its height at the top, where it says who is who and what time it is
COLUMNS = 96  # of a command
HEAD = """
# Gallery

`python docs/gallery.py` writes this page and runs the commands under each film. The cloth is blue; the target over it
is translucent green; where both coincide the picture is teal. Red dots are held vertices. The films are scaled down for
this page. `clothfit report` [plays such motions in 3-D](report.md); [pictures.md](pictures.md) describes films and
pictures.
"""


class Film(NamedTuple):
    """A part of the gallery."""

    name: str
    title: str
    text: str
    commands: tuple[str, ...]
    captions: tuple[tuple[str, str], ...] = ()  # of several films side by side: files and what is written above them


CURTAIN = Film(
    "curtain",
    "A curtain, before and after",
    "The walk of [the first page](../README.md#a-five-minute-walk): a first guess of the fabric, 529 mm off the shot, "
    "and the fit, 52 nm off.",
    (
        "new plane --size 2 --upright --fix-vertices 132,143 --stiffness 12 --damping 0.5 --wind 1,0,3 --drag air "
        "--fit nL -o theirs.json",
        "simulate theirs.json -o 'shot_*.obj'",
        "new 'shot_*.obj' --fix-vertices 132,143 --damping 0.5 --wind 1,0,3 --drag air --fit nL -o curtain.json",
        "evaluate curtain.json curtain.json --target 'shot_*.obj' --gif guess.gif",
        "estimate curtain.json --target 'shot_*.obj' --rmse 1e-4 -o fitted.json --gif fit.gif",
    ),
    (("guess.gif", "first guess"), ("fit.gif", "after the fit")),
)


def example(name: str, title: str, text: str) -> Film:
    """The fit of one of the examples."""
    return Film(name, title, text, (f"estimate examples/{name}.json -o {name}.fitted.json --gif {name}.gif",))


def made(name: str, title: str, text: str, options: str) -> Film:
    """The motion of a plane that `new` makes."""
    return Film(
        name, title, text, (f"new plane {options} -o {name}.json", f"simulate {name}.json -q --gif {name}.gif")
    )


GALLERY = (
    CURTAIN,
    made(
        "banner",
        "A flag in the wind",
        "`--drag air` chooses the drag with which faces of this size feel the wind as in reality.",
        "--size 3x2 --divisions 16 --upright --fix-side left --wind 7,0,1.5 --drag air --stiffness 200",
    ),
    made(
        "ball",
        "A cloth falls on a ball",
        "No vertex is held; only the sphere stops the fall.",
        "--size 2 --divisions 20 --move 0,0.75,0 --sphere 0,0,0,0.6 --damping 0.5",
    ),
    made(
        "table",
        "A tablecloth",
        "The vertices on the table are held; the rest hangs over its edge.",
        "--size 2.4 --divisions 14 --fix-box -0.7,-1,-0.7:0.7,1,0.7 --damping 0.6",
    ),
    example("side", "Held at one side: 726 stiffnesses", "A trial: the fit recovers the hidden values."),
    example("corners", "Held at four corners: 144 masses", "One mass for each vertex, from its motion alone."),
    example(
        "flag",
        "Where one number is not enough",
        "The springs of this flag differ. With one stiffness for all of them the fit stays 353 mm off: blue and green "
        "separate.",
    ),
    example("drape", "On a big ball: one mass", "The best that one mass for all vertices can do, 27 mm off."),
)


def page() -> str:
    """The page."""
    return "\n\n".join([cleandoc(HEAD), *(part for film in GALLERY for part in chapter(film))]) + "\n"


def chapter(film: Film) -> Iterator[str]:
    """The paragraphs on one film."""
    yield f"## {film.title}"
    yield f"![{film.title}](gallery/{film.name}.gif)"
    yield film.text
    lines = (line for command in film.commands for line in wrapped(f"clothfit {command}", COLUMNS))
    yield "\n".join(["```sh", *lines, "```"])


def shoot(film: Film) -> list[Path]:
    """Run the commands of a film in this folder: the files that it is made of."""
    for command in film.commands:
        if run(shlex.split(command)) != 0:
            raise SystemExit(f"clothfit {command} failed")
    return [Path(name) for name, _ in film.captions] or [Path(f"{film.name}.gif")]


def frames(path: Path) -> tuple[list[Image.Image], list[int]]:
    """The frames of a GIF, made smaller, and for how long each is shown, ms."""
    with Image.open(path) as film:
        size = (WIDTH, round(film.height * WIDTH / film.width))
        shown = [(one.convert("RGB"), int(one.info["duration"])) for one in ImageSequence.Iterator(film)]
    return [one.resize(size, Image.Resampling.BOX) for one, _ in shown], [duration for _, duration in shown]


def beside(parts: list[list[Image.Image]], captions: list[str]) -> list[Image.Image]:
    """Films side by side, in place of the legend what each is: that of a guess would say "fitted"."""
    font = ImageFont.load_default(17)
    height, top = max(one[0].height for one in parts) - LEGEND, 28
    sheets = []
    for shown in zip(*parts, strict=True):
        sheet = Image.new("RGB", (WIDTH * len(shown), height + top), GROUND)
        for column, (one, caption) in enumerate(zip(shown, captions, strict=True)):
            sheet.paste(one.crop((0, LEGEND, *one.size)), (column * WIDTH, top))
            ImageDraw.Draw(sheet).text(((column + 0.5) * WIDTH, 16), caption, font=font, fill=GIF_INK, anchor="mm")
        sheets.append(sheet)
    return sheets


def save(shown: list[Image.Image], durations: list[int], path: Path) -> None:
    """Write a looping GIF whose frames share a palette."""
    colours = palette(shown)
    first, *rest = (one.quantize(palette=colours, dither=Image.Dither.NONE) for one in shown)
    first.save(path, "GIF", save_all=True, append_images=rest, duration=durations, loop=0, optimize=False, disposal=1)


def write(film: Film, path: Path) -> None:
    """Run the commands of a film in this folder and write it."""
    parts = [frames(part) for part in shoot(film)]
    films, captions = [one for one, _ in parts], [caption for _, caption in film.captions]
    save(beside(films, captions) if captions else films[0], parts[0][1], path)


def main() -> None:
    """Write the page and all films."""
    FILMS.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        shutil.copytree(DOCS.parent / "examples", Path(folder) / "examples")
        os.chdir(folder)
        for film in GALLERY:
            write(film, FILMS / f"{film.name}.gif")
        os.chdir(DOCS)
    PAGE.write_text(page(), encoding="utf-8")


if __name__ == "__main__":
    main()
