"""The work–precision diagram: what it shows, in which formats, and what it needs."""

import math
import sys
from dataclasses import replace

import numpy as np
import pytest
from helpers.physics import scene, thing

from clothfit.base.errors import InvalidInput
from clothfit.evaluation.reference import Reference
from clothfit.evaluation.work_precision import Setting, Trial, grid, table
from clothfit.pictures.diagram import draw, save_diagram
from clothfit.pictures.picture_file import GIF, check_picture

pytest.importorskip("matplotlib", reason="matplotlib is not installed; no picture is drawn")

POINT = scene(thing([(0, 0, 0)]))
STARTS = {"a.PNG": b"\x89PNG\r\n\x1a\n", "a.svg": b"<?xml", "b.svg": b"<?xml", "a.pdf": b"%PDF"}


def measured(own_error=1e-6, scale=0.01, settings=None):
    """A table with made-up numbers: errors of order 1 below `scale` m, a reference known to `own_error` m."""
    positions = np.zeros((3, 1, 3))
    positions[:, 0, 0] = 0.0, 5.0, 10.0
    known = Reference(positions, np.full(3, own_error), 1e-4, 2.0)
    trials = []
    for i, setting in enumerate(settings or grid(POINT)):
        squares = np.full(3, (scale * setting.ratio) ** 2)
        trials.append(Trial(setting, setting.steps(3), "done", [1e-3 * (i + 2)], squares, np.sqrt(squares)))
    return table(POINT, trials, known)


FOUND = measured()


def labels(figure):
    """The names in the legend."""
    return [text.get_text() for text in figure.axes[0].get_legend().get_texts()]


def words(figure):
    """The annotations."""
    return [text.get_text() for text in figure.axes[0].texts]


def test_a_picture_is_of_the_kind_its_name_says_and_the_same_each_time(tmp_path):
    for name, begins in STARTS.items():
        save_diagram(FOUND, tmp_path / name, 0.005)
        assert (tmp_path / name).read_bytes().startswith(begins)
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(STARTS)
    assert (tmp_path / "a.svg").read_bytes() == (tmp_path / "b.svg").read_bytes()


def test_it_has_axes_with_units_and_a_line_per_integrator_whose_points_are_the_rows():
    figure = draw(FOUND, 0.005)
    (axes,) = figure.axes
    assert (axes.get_xscale(), axes.get_yscale()) == ("log", "log")
    assert "seconds" in axes.get_xlabel()
    assert axes.get_ylabel().endswith(", m")
    assert {"explicit", "symplectic", "implicit, 1 iteration", "implicit, 2 iterations", "implicit, 4 iterations",
            "Pareto-best", "asked for: 5 mm"} <= set(labels(figure))  # fmt: skip
    assert "the scene's own" in words(figure)
    assert "↓ the reference's own error: 1 µm" in words(figure)
    assert "the reference's own error: 30 µm" in labels(draw(measured(own_error=3e-5)))  # hardly better: it has a line
    (line,) = (line for line in axes.get_lines() if line.get_label() == "symplectic")
    rows = [row for row in FOUND.rows if row.setting.integrator == "symplectic"]
    np.testing.assert_array_equal(line.get_xydata(), [row.cost_and_error for row in rows])


def test_errors_of_0_are_drawn(tmp_path):
    found = measured(own_error=0.0, scale=0.0)
    assert {row.error for row in found.rows} == {0.0}
    (axes,) = draw(found).axes
    assert all(np.isfinite(line.get_xydata()).all() for line in axes.get_lines() if len(line.get_xydata()))
    assert all(low > 0 and math.isfinite(high) for low, high in (axes.get_xlim(), axes.get_ylim()))
    save_diagram(found, tmp_path / "zero.png")


def test_rows_without_numbers_are_left_out_and_iterations_may_be_more_than_colours(tmp_path):
    rows = [replace(row, status="diverged", error=None, seconds_per_second=None, pareto=False) for row in FOUND.rows]
    found = replace(FOUND, rows=rows)
    assert labels(draw(found)) == ["faint: other tolerances", "the reference's own error: 1 µm"]
    save_diagram(found, tmp_path / "none.png")
    settings = [Setting("implicit", 1.0, 1e-5, newton) for newton in range(1, 8)]
    assert len([name for name in labels(draw(measured(settings=settings))) if name.startswith("implicit")]) == 7


def test_what_cannot_be_drawn_or_written_is_refused(tmp_path, monkeypatch):
    kinds = "ends in .png, .svg or .pdf"
    for name, message in (("speed.jpg", kinds), ("speed", kinds), ("absent/speed.png", "does not exist")):
        with pytest.raises(InvalidInput, match=message):
            save_diagram(FOUND, tmp_path / name)
    with pytest.raises(InvalidInput, match=r"ends in \.gif$"):
        check_picture(tmp_path / "x.png", GIF)
    assert list(tmp_path.iterdir()) == []
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(InvalidInput, match="a picture needs matplotlib; install it with: pip install"):
        save_diagram(FOUND, tmp_path / "speed.png")
