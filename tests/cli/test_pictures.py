"""--plot and --gif of the commands."""

import pytest
from helpers.scenes import trial, write_scene

pytestmark = pytest.mark.slow  # compiles a fit

pytest.importorskip("matplotlib", reason="matplotlib is not installed; no picture is drawn")
pytest.importorskip("PIL", reason="Pillow is not installed; no animation is drawn")

SIGNS = {".png": b"\x89PNG", ".gif": b"GIF8", ".svg": b"<?xml", ".pdf": b"%PDF"}


@pytest.fixture(autouse=True)
def scene(here):
    """The folder has a scene to fit."""
    write_scene(here, trial("nG", 5))


def signed(name):
    """Whether a file begins as its name says."""
    with open(name, "rb") as file:
        return file.read(5).startswith(SIGNS[name[name.rindex(".") :]])


def test_every_command_draws(said):
    assert said("simulate scene.json --energy --plot a.svg --gif a.gif")[0] == 0
    code, _, err = said("estimate scene.json -o fitted.json --plot {stem}.png --gif b.gif")
    assert (code, err.endswith("picture → scene.png\nanimation → b.gif\n")) == (0, True)
    assert said("evaluate scene.json fitted.json --steps 7 --plot c.pdf --gif c.gif")[0] == 0
    assert all(signed(name) for name in ("a.svg", "a.gif", "scene.png", "b.gif", "c.pdf", "c.gif"))


def test_a_fit_to_a_target_with_a_scene_of_its_own_is_drawn_over_that(here, said):
    write_scene(here, trial("nG", 8, windVel={"x": 2.0, "y": 0.0, "z": 0.0}), "windy.json")
    assert said("target windy.json -q -o windy.npz --every 2 --observed 0.6")[0] == 0
    line = "estimate scene.json -q -o fitted.json --target windy.npz@windy.json --plot fit.png --gif fit.gif"
    assert said(line)[0] in (0, 5)
    assert signed("fit.png")
    assert signed("fit.gif")


def test_a_motion_that_diverges_is_drawn_as_far_as_it_is_good(here, said):
    write_scene(here, trial("nG", 60, integrationMethod=0, springStiffness=[9e3] * 33), "wild.json")
    assert said("simulate wild.json -q --plot wild.png --gif wild.gif")[0] == 4
    assert signed("wild.png")
    assert signed("wild.gif")
