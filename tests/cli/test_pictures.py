"""--plot and --gif of the commands."""

import re
import sys

import pytest
from helpers.paths import DOCS
from helpers.scenes import names, trial, write_scene

from clothfit.cli.program import run

pytestmark = pytest.mark.slow  # compiles a fit

pytest.importorskip("matplotlib", reason="matplotlib is not installed; no picture is drawn")
pytest.importorskip("PIL", reason="Pillow is not installed; no animation is drawn")

SIGNS = {".png": b"\x89PNG", ".gif": b"GIF8", ".svg": b"<?xml", ".pdf": b"%PDF"}


@pytest.fixture
def path(tmp_path, monkeypatch):
    """The path of a scene to fit, alone in the current folder."""
    monkeypatch.chdir(tmp_path)
    return write_scene(tmp_path, trial("nG", 12))


def signed(name):
    """Whether a file begins as its name says."""
    with open(name, "rb") as file:
        return file.read(5).startswith(SIGNS[name[name.rindex(".") :]])


def test_every_command_draws(path, capsys):
    assert run(["simulate", path, "--energy", "--plot", "a.svg", "--gif", "a.gif"]) == 0
    assert run(["estimate", path, "-o", "fitted.json", "--plot", "{stem}.png", "--gif", "b.gif"]) == 0
    told = capsys.readouterr().err
    assert told.endswith("picture → scene.png\nanimation → b.gif\n")
    assert run(["evaluate", path, "fitted.json", "--steps", "20", "--plot", "c.pdf", "--gif", "c.gif"]) == 0
    assert all(signed(name) for name in ("a.svg", "a.gif", "scene.png", "b.gif", "c.pdf", "c.gif"))


def test_a_fit_to_a_target_with_a_scene_of_its_own_is_drawn_over_that(path, tmp_path):
    write_scene(tmp_path, trial("nG", 8, windVel={"x": 2.0, "y": 0.0, "z": 0.0}), "windy.json")
    assert run(["target", "windy.json", "-q", "-o", "windy.npz", "--every", "2", "--observed", "0.6"]) == 0
    told = ["--target", "windy.npz@windy.json", "--plot", "fit.png", "--gif", "fit.gif"]
    assert run(["estimate", path, "-q", "-o", "fitted.json", *told]) in (0, 5)
    assert signed("fit.png")
    assert signed("fit.gif")


def test_a_motion_that_diverges_is_drawn_as_far_as_it_is_good(path, tmp_path):
    wild = write_scene(tmp_path, trial("nG", 60, integrationMethod=0, springStiffness=[9e3] * 33), "wild.json")
    assert run(["simulate", wild, "-q", "--plot", "wild.png", "--gif", "wild.gif"]) == 4
    assert signed("wild.png")
    assert signed("wild.gif")


@pytest.mark.parametrize("command", [["simulate"], ["estimate"], ["evaluate", "scene.json"]])
@pytest.mark.parametrize(
    ("option", "message"),
    [
        (["--plot", "x.jpg"], "x.jpg: a picture's name ends in .png, .svg or .pdf"),
        (["--gif", "x.png"], "x.png: a picture's name ends in .gif"),
        (["--plot", "absent/x.png"], "cannot write absent/x.png: the folder"),
        (["--plot", "scene.json"], "cannot write scene.json: it is an input or another output"),
    ],
)
def test_what_cannot_be_drawn_is_said_before_anything_is_done(path, capsys, command, option, message):
    assert run([command[0], path, *command[1:], *option]) == 3
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    assert err.startswith(f"error: {message}")
    assert names() == ["scene.json"]


@pytest.mark.parametrize(
    ("option", "module", "library"), [("--plot x.png", "matplotlib", "matplotlib"), ("--gif x.gif", "PIL", "Pillow")]
)
@pytest.mark.parametrize("command", ["simulate scene.json", "estimate scene.json", "evaluate scene.json scene.json"])
def test_a_missing_library_is_named_before_anything_is_done(
    path, capsys, monkeypatch, command, option, module, library
):
    monkeypatch.setitem(sys.modules, module, None)
    assert run([*command.split(), *option.split()]) == 3
    name = option.split()[1]
    line = f"error: {name}: a picture needs {library}; install it with: pip install 'clothfit[plot]'\n"
    assert capsys.readouterr() == ("", line)
    assert names() == ["scene.json"]


@pytest.mark.parametrize("option", ["--plot=x.png", "--gif=x.gif", "--log=x.jsonl"])
@pytest.mark.parametrize("several", [["scene.json"], ["--starts", "2"], ["--cluster", "tcp://h:1"]])
def test_several_fits_have_no_pictures_and_no_log(path, capsys, option, several):
    assert run(["estimate", path, *several, option]) == 2
    assert "is for one scene fitted from one start on this machine" in capsys.readouterr().err
    assert names() == ["scene.json"]


def test_the_python_of_the_page_draws(path, tmp_path):
    write_scene(tmp_path, trial("nG", 12, springStiffness=[20.0] * 33), "fitted.json")
    page = (DOCS / "pictures.md").read_text("utf-8")
    (block,) = re.findall(r"^```python\n(.*?)^```", page, re.DOTALL | re.MULTILINE)
    exec(compile(block, "docs/pictures.md", "exec"), {})
    assert signed("error.png")
    assert signed("error.gif")
