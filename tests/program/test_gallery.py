"""The gallery: its page is what the script writes, and its films are there and move."""

import re

import numpy as np
import pytest
from helpers.modules import script
from helpers.paths import ROOT

from clothfit.base.eigen import connected_components
from clothfit.meshes.mesh import Mesh
from clothfit.meshes.problems import problems

pytestmark = pytest.mark.slow  # looks at all films

Image = pytest.importorskip("PIL.Image", reason="Pillow draws the films")
gallery = script(ROOT / "docs" / "gallery.py")
FILMS = {film.name: gallery.FILMS / f"{film.name}.gif" for film in gallery.GALLERY}


def test_the_page_shows_every_film_and_the_commands_that_make_it():
    page = gallery.PAGE.read_text("utf-8")
    assert page == gallery.page(), "python docs/gallery.py writes it again"
    shown = page.replace(" \\\n    ", " ").splitlines()
    assert re.findall(r"^!\[.*\]\(gallery/(.+)\.gif\)$", page, re.MULTILINE) == list(FILMS)
    assert [c for film in gallery.GALLERY for c in film.commands if gallery.typed(c) not in shown] == []


@pytest.mark.parametrize("path", FILMS.values(), ids=FILMS)
def test_a_film_loops_moves_and_is_small(path):
    with Image.open(path) as film:
        assert film.width >= 640
        assert film.n_frames > 20
        assert film.info["loop"] == 0
        first = np.asarray(film.convert("RGB"), dtype=int)
        film.seek(film.n_frames // 2)
        middle = np.asarray(film.convert("RGB"), dtype=int)
    assert (abs(middle - first).max(axis=2) > 40).mean() > 0.01  # a hundredth of the picture looks different
    assert path.stat().st_size < 1_500_000


def test_the_curtain_is_that_of_the_first_page_and_there_are_no_other_films_all_small_together_and_of_no_storm():
    readme = (ROOT / "README.md").read_text("utf-8").replace(" \\\n    ", " ")
    commands = [command.partition(" --set gif=")[0] for command in gallery.CURTAIN.commands]
    guess = [command for command in commands if command.startswith("evaluate")]  # its film is the gallery's alone
    assert [command for command in commands if f"$ clothfit {command}" not in readme] == guess
    assert {path.name for path in gallery.FILMS.iterdir()} == {path.name for path in FILMS.values()}
    assert sum(path.stat().st_size for path in FILMS.values()) < 7_000_000
    winds = re.findall(r"--wind (\S+)", gallery.PAGE.read_text("utf-8"))
    assert winds
    assert max(abs(float(part)) for wind in winds for part in wind.split(",")) < 15.0  # m/s


def test_the_garments_are_sewn_and_open_where_they_should_be():
    make = script(ROOT / "examples" / "garments.py")
    openings = {"shirt": 4}  # neck, hem and two cuffs
    for name, build in make.GARMENTS.items():
        points, faces = build()
        assert problems(Mesh(points, np.asarray(faces, np.int32))) == [], name
        edges = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
        unique, count = np.unique(edges, axis=0, return_counts=True)
        assert count.max() == 2
        rims = unique[count == 1]
        assert len(np.unique(connected_components(rims, len(points))[rims])) == openings[name]
        assert len(points) - len(unique) + len(faces) == 2 - openings[name]  # of Euler: a sphere with holes
        assert 0.2 < np.ptp(points, axis=0).max() < 2.5  # m
