"""Pictures of motions and fits: files that can be read, with something in each part."""

import io
import xml.etree.ElementTree as ElementTree
from functools import partial

import numpy as np
import pytest
from helpers.scenes import cloth, document, even

from clothfit import energies, parameters, simulate, with_parameters
from clothfit.base.errors import InvalidInput
from clothfit.optimise.progress import Progress
from clothfit.pictures.overlay import overlaid
from clothfit.pictures.picture_file import DOTS_PER_INCH, GIF, check, save
from clothfit.scene.scene import load

matplotlib = pytest.importorskip("matplotlib", reason="matplotlib is not installed; no picture is drawn")

from clothfit.pictures import charts, maps, plots  # noqa: E402  what is there without matplotlib comes first

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


def test_a_png_has_its_size_and_something_in_every_part(tmp_path):
    image = pytest.importorskip("PIL.Image")
    save(tmp_path / "fit.png", fitted)
    picture = np.asarray(image.open(tmp_path / "fit.png").convert("L")).astype(int)
    height, width = picture.shape
    assert width == DOTS_PER_INCH * plots.PAGE_WIDTH
    assert height > DOTS_PER_INCH * (plots.HEAD_HEIGHT + 2 * plots.ROW_HEIGHT)
    for band in np.array_split(picture, 6):  # head and strip, charts, maps
        for part in np.array_split(band[:, : int(0.6 * width)], 2, axis=1):
            assert np.ptp(part) > 60


def test_an_svg_is_xml_and_the_same_each_time(tmp_path):
    for name in ("a.svg", "b.svg"):
        save(tmp_path / name, partial(fitted, "nL"))
    root = ElementTree.parse(tmp_path / "a.svg").getroot()
    assert root.tag == "{http://www.w3.org/2000/svg}svg"
    assert len(list(root.iter("{http://www.w3.org/2000/svg}path"))) > 100
    assert (tmp_path / "a.svg").read_bytes() == (tmp_path / "b.svg").read_bytes()


def test_a_pdf_is_one(tmp_path):
    truth = load(even("nG", 3))
    motion = simulate(truth)
    save(tmp_path / "x.pdf", partial(plots.simulation, truth, motion.times, motion.positions))
    assert (tmp_path / "x.pdf").read_bytes().startswith(b"%PDF")


def test_a_fit_tells_what_it_found():
    words = texts(fitted())
    for word in ("converged: as hoped", "convergence", "distance to the target", "mass, kg", "stiffness, N/m",
                 "fitted frames", "20 mm", "in a window of fewer frames", "0.14 s"):  # fmt: skip
        assert word in words
    assert "objects[0] stiffness" in texts(fitted("nG"))  # one value is a line, not a map


def test_an_evaluation_tells_deviations_and_the_horizon():
    truth, found = pair("GL")
    over = overlaid(truth, found, None, 12)
    words = texts(plots.evaluation(over, truth, "RMSE", 0.14, float(over.times[-1])))
    for word in ("horizon", "stiffness: deviation", "fitted / true − 1", "(true: 0.02)"):
        assert word in words


def test_a_simulation_tells_its_energy_where_that_is_known():
    truth = load(even("nG", 5))
    motion = simulate(truth)
    with_energy = plots.simulation(truth, motion.times, motion.positions, energies(truth, motion))
    assert "kinetic" in texts(with_energy)
    assert "kinetic" not in texts(plots.simulation(truth, motion.times, motion.positions))


def test_a_motion_that_diverges_is_drawn_as_far_as_it_is_good():
    truth = load(even("nG", 12))
    motion = simulate(truth)
    wild = motion.positions.copy()
    wild[5:] *= 1e12
    assert f"{motion.times[4]:.2f} s" in texts(plots.simulation(truth, motion.times, wild))
    assert f"{motion.times[5]:.2f} s" not in texts(plots.simulation(truth, motion.times, wild))


def test_maps_know_what_the_motion_cannot_show():
    truth, found = pair("LL")
    mass, stiffness = maps.maps(found)
    assert mass.values.shape == (16,)
    assert (~mass.known).sum() == 2  # the fixed corners
    assert stiffness.places.shape == (len(truth.cloths[0].springs), 2, 3)
    away, _ = maps.maps(found, truth)
    expected = found.cloths[0].mass / truth.cloths[0].mass - 1.0
    np.testing.assert_allclose(away.values, expected, rtol=1e-12)


def test_maps_of_many_values_show_some_of_them(monkeypatch):
    monkeypatch.setattr(maps, "MOST_MAP_VALUES", 10)
    (mass,) = maps.maps(load(even("Ln", 3)))
    assert mass.places.shape == (10, 3)


@pytest.mark.parametrize(("history", "last"), [(HISTORY[:1], 0.2), (HISTORY, 0.02)])
def test_convergence_is_drawn_whatever_is_known(history, last):
    axes = matplotlib.figure.Figure().add_subplot()
    charts.convergence(axes, history)
    axes.figure.savefig(io.BytesIO())
    best = [line for line in axes.lines if line.get_label() == "best, all frames"]
    assert [line.get_ydata()[-1] for line in best] == [pytest.approx(last)]


@pytest.mark.parametrize("history", [[], HISTORY[:1]])
def test_a_fit_without_a_search_has_no_panel_for_one(history):
    words = texts(fitted(history=history))
    assert "convergence" not in words
    assert "distance to the target" in words


def test_an_error_of_nothing_has_no_logarithm():
    axes = matplotlib.figure.Figure().add_subplot()
    charts.error(axes, np.arange(3.0), np.zeros(3), np.zeros(3), 2.0)
    axes.figure.savefig(io.BytesIO())
    assert "no difference" in texts(axes.figure)


def test_two_cloths_of_which_one_is_fitted_have_a_map_of_that_one():
    scene = load(document(cloth(), cloth(optimizationSettings="Ln")))
    (shown,) = maps.maps(scene)
    assert len(shown.values) == 12


def test_a_picture_of_another_kind_is_refused(tmp_path):
    with pytest.raises(InvalidInput, match=r"ends in \.gif$"):
        check(tmp_path / "x.png", GIF)
