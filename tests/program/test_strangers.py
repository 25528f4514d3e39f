"""The page on shots of other programs: what the script writes of its figures, whose films are there."""

import json

import pytest
from helpers.modules import script
from helpers.paths import ROOT

pytest.importorskip("PIL.Image", reason="Pillow draws the films")
strangers = script(ROOT / "docs" / "strangers.py")
FIGURES = json.loads(strangers.FIGURES.read_text("utf-8"))


def test_the_page_is_what_the_script_writes():
    assert strangers.PAGE.read_text("utf-8") == strangers.page(), "make gallery writes it again"
    assert {path.stem for path in strangers.FILMS.glob("*.gif")} == set(FIGURES)
    assert set(FIGURES) <= {each.name for each in strangers.SHOTS}
    assert sum(path.stat().st_size for path in strangers.FILMS.glob("*.gif")) < 3_000_000


def test_no_fit_is_worse_than_its_start_and_a_still_picture_is_worse_or_the_page_says_so():
    for own in FIGURES.values():
        assert own["error"] <= own["start"]
        assert (own["verdict"] == "fails") == (own["error"] >= own["still"])
