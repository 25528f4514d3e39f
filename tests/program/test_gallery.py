"""The gallery: its page is what the script writes, its films are there and move, and its commands make them."""

import re
import shutil
from importlib import util

import numba
import numpy as np
import pytest
from helpers.paths import ROOT

pytestmark = pytest.mark.slow  # compiles a fit

Image = pytest.importorskip("PIL.Image", reason="Pillow draws the films")
SPEC = util.spec_from_file_location("gallery_page", ROOT / "docs" / "gallery.py")
gallery = util.module_from_spec(SPEC)
SPEC.loader.exec_module(gallery)
FILMS = {film.name: gallery.FILMS / f"{film.name}.gif" for film in gallery.GALLERY}


def test_the_page_is_what_the_script_writes():
    assert gallery.PAGE.read_text("utf-8") == gallery.page(), "python docs/gallery.py writes it again"


def test_the_page_shows_every_film_and_the_commands_that_make_it():
    page = gallery.PAGE.read_text("utf-8")
    shown = page.replace(" \\\n    ", " ").splitlines()
    assert re.findall(r"^!\[.*\]\(gallery/(.+)\.gif\)$", page, re.MULTILINE) == list(FILMS)
    assert [c for film in gallery.GALLERY for c in film.commands if f"clothfit {c}" not in shown] == []


@pytest.mark.parametrize("path", FILMS.values(), ids=FILMS)
def test_a_film_loops_moves_and_is_small(path):
    with Image.open(path) as film:
        assert film.n_frames > 20
        assert film.info["loop"] == 0
        first = np.asarray(film.convert("RGB"), dtype=int)
        film.seek(film.n_frames // 2)
        middle = np.asarray(film.convert("RGB"), dtype=int)
    assert (abs(middle - first).max(axis=2) > 40).mean() > 0.01  # a hundredth of the picture looks different
    assert path.stat().st_size < 600_000


def test_there_are_no_other_films_and_all_are_small_together():
    assert {path.name for path in gallery.FILMS.iterdir()} == {path.name for path in FILMS.values()}
    assert sum(path.stat().st_size for path in FILMS.values()) < 3_000_000


def test_the_curtain_is_that_of_the_first_page():
    readme = (ROOT / "README.md").read_text("utf-8").replace(" \\\n    ", " ")
    commands = [command.partition(" --gif")[0] for command in gallery.CURTAIN.commands]
    guess = [command for command in commands if command.startswith("evaluate")]  # its film is the gallery's alone
    assert [command for command in commands if f"$ clothfit {command}" not in readme] == guess


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="the motion needs compilation")
def test_the_commands_make_a_film(tmp_path, monkeypatch):
    shutil.copytree(ROOT / "examples", tmp_path / "examples")
    monkeypatch.chdir(tmp_path)
    film = next(film for film in gallery.GALLERY if film.name == "corners")
    gallery.write(film, tmp_path / "made.gif")
    with Image.open(tmp_path / "made.gif") as made, Image.open(FILMS["corners"]) as kept:
        assert (made.size, made.n_frames) == (kept.size, kept.n_frames)
