"""Pictures of motions and fits: files that can be read, with something in each part; fitted motions over targets."""

import io
import xml.etree.ElementTree as ElementTree
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from helpers.scenes import cloth, document, even
from numpy.testing import assert_allclose

from clothfit import as_motion, energies, evaluate, load, parameters, simulate, with_parameters
from clothfit.evaluation.evaluate import overlaid
from clothfit.optimise.progress import Progress
from clothfit.pictures import charts, maps, plots
from clothfit.pictures.picture_file import DOTS_PER_INCH, save

matplotlib = pytest.importorskip("matplotlib", reason="matplotlib is not installed; no picture is drawn")

HISTORY = [
    Progress(1, 100, 4.0, 0.2, 0.1, 0, np.nan, "gauss-newton", 8, 8),
    Progress(3, 100, 4.0, 0.2, 0.2, 1, 0.5, "gauss-newton", 4, 8, 0.01),
    Progress(5, 100, 0.04, 0.02, 0.3, 2, 0.1, "gauss-newton", 8, 8),
]


def pair(settings):
    """A true scene and one that deviates by up to half."""
    truth = load(even(settings, 8))
    p = parameters(truth)
    return truth, with_parameters(truth, p * np.linspace(0.5, 1.5, len(p)))


def texts(figure):
    """All words of a figure."""
    return " | ".join(part.get_text() for part in figure.findobj(matplotlib.text.Text))


def fitted(settings="LL", history=HISTORY):
    truth, found = pair(settings)
    return plots.estimation(overlaid(truth, found, None, 8), "converged: as hoped", history, 0.14)


def test_a_png_has_its_size_and_something_in_every_part_and_an_svg_is_xml(tmp_path):
    image = pytest.importorskip("PIL.Image")
    save(tmp_path / "fit.png", fitted)
    picture = np.asarray(image.open(tmp_path / "fit.png").convert("L")).astype(int)
    height, width = picture.shape
    assert width == DOTS_PER_INCH * plots.PAGE_WIDTH
    assert height > DOTS_PER_INCH * (plots.HEAD_HEIGHT + 2 * plots.ROW_HEIGHT)
    for band in np.array_split(picture, 6):  # head and strip, charts, maps
        for part in np.array_split(band[:, : int(0.6 * width)], 2, axis=1):
            assert np.ptp(part) > 60


    save(tmp_path / "a.svg", partial(fitted, "nL"))
    root = ElementTree.parse(tmp_path / "a.svg").getroot()
    assert root.tag == "{http://www.w3.org/2000/svg}svg"
    assert len(list(root.iter("{http://www.w3.org/2000/svg}path"))) > 100


def test_a_fit_tells_what_it_found():
    words = texts(fitted())
    for word in ("converged: as hoped", "convergence", "distance to the target", "mass, kg", "stiffness, N/m",
                 "fitted frames", "20 mm", "in a window of fewer frames", "0.14 s"):  # fmt: skip
        assert word in words
    words = texts(fitted("nG", HISTORY[:1]))
    assert "objects[0] stiffness" in words  # one value is a line, not a map
    assert "convergence" not in words  # without a search there is no panel for one
    assert "distance to the target" in words


def test_an_evaluation_tells_deviations_and_the_horizon():
    truth, found = pair("GL")
    over = overlaid(truth, found, None, 12)
    words = texts(plots.evaluation(over, truth, "RMSE", 0.14, float(over.times[-1])))
    for word in ("horizon", "stiffness: deviation", "fitted / true − 1", "(true: 0.02)"):
        assert word in words


def test_a_simulation_tells_its_energy_where_that_is_known_and_is_drawn_as_far_as_it_is_good():
    truth = load(even("nG", 12))
    motion = simulate(truth)
    assert "kinetic" in texts(plots.simulation(truth, motion.times, motion.positions, energies(truth, motion)))
    wild = motion.positions.copy()
    wild[5:] *= 1e12
    words = texts(plots.simulation(truth, motion.times, wild))
    assert f"{motion.times[4]:.2f} s" in words
    assert f"{motion.times[5]:.2f} s" not in words
    assert "kinetic" not in words


def test_maps_know_what_the_motion_cannot_show_and_show_some_of_many_values(monkeypatch):
    truth, found = pair("LL")
    mass, stiffness = maps.maps(found)
    assert mass.values.shape == (16,)
    assert (~mass.known).sum() == 2  # the fixed corners
    assert stiffness.places.shape == (len(truth.cloths[0].springs), 2, 3)
    away, _ = maps.maps(found, truth)
    expected = found.cloths[0].mass / truth.cloths[0].mass - 1.0
    np.testing.assert_allclose(away.values, expected, rtol=1e-12)


    (shown,) = maps.maps(load(document(cloth(), cloth(optimizationSettings="Ln"))))  # of the one that is fitted
    assert len(shown.values) == 12
    monkeypatch.setattr(maps, "MOST_MAP_VALUES", 10)
    (mass,) = maps.maps(load(even("Ln", 3)))
    assert mass.places.shape == (10, 3)


def test_convergence_is_drawn_whatever_is_known_and_no_error_has_no_logarithm():
    for history, last in ((HISTORY[:1], 0.2), (HISTORY, 0.02)):
        axes = matplotlib.figure.Figure().add_subplot()
        charts.convergence(axes, history)
        axes.figure.savefig(io.BytesIO())
        best = [line for line in axes.lines if line.get_label() == "best, all frames"]
        assert [line.get_ydata()[-1] for line in best] == [pytest.approx(last)]
    axes = matplotlib.figure.Figure().add_subplot()
    charts.error(axes, np.arange(3.0), np.zeros(3), np.zeros(3), 2.0)
    axes.figure.savefig(io.BytesIO())
    assert "no difference" in texts(axes.figure)


@pytest.fixture(scope="module")
def stiffer():
    truth = load(even("nG", 8))
    return truth, with_parameters(truth, 1.3 * parameters(truth))


def test_the_errors_of_the_frames_are_those_that_evaluate_tells_with_finer_steps_too(stiffer):
    truth, fitted = stiffer
    for own in (truth, fitted, fitted.with_step(truth.delta / 2, 15)):
        over, told = overlaid(truth, own, None, 8), evaluate(truth, own, horizon=8)
        assert over.own.shape == over.goal.shape == (8, 16, 3)
        assert_allclose(np.sqrt((over.rmse**2).mean()), told.fitted.rmse, rtol=1e-9)
        assert_allclose(over.largest.max(), told.fitted.max_error, rtol=1e-9)
        assert over.rmse.any() == (own is not truth)


def test_a_target_between_the_steps_is_met_there_and_what_was_not_observed_does_not_count(stiffer):
    truth, _ = stiffer
    x = simulate(truth, 8, 1e-10).positions
    target = as_motion(truth, 0.5 * (x[:-1] + x[1:]), truth.delta * (0.5 + np.arange(7)))
    assert_allclose(overlaid(truth, truth, target, 8).rmse, 0.0, atol=1e-12)
    assert len(overlaid(truth, truth, target, 5).times) == 4  # those that five frames reach
    x, seen = x[:4].copy(), np.ones((4, 16), bool)
    seen[2, 3] = seen[3] = False
    x[2, 3] += 100.0
    over = overlaid(truth, truth, as_motion(truth, x, observed=seen), 4)
    assert np.isnan(over.goal[2, 3]).all()
    assert_allclose(over.rmse, [0, 0, 0, np.nan], atol=1e-12)


def test_a_motion_that_diverges_is_shown_until_then(stiffer):
    truth, fitted = stiffer
    wild = replace(fitted, method=0, delta=truth.delta * 1.0)
    over = overlaid(truth, with_parameters(wild, [9e3]), None, 8)
    assert 1 <= len(over.times) <= 8
    assert np.isfinite(over.own).all()
