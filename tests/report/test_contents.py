"""What a page says of a fit: its verdict, its tables, the motions beside it, the residuals, and colours to be read."""

import re

import numpy as np
import pytest
from helpers.scenes import even
from helpers.unpacking import content_of

from clothfit import as_motion, load, parameters, simulate
from clothfit.report import findings
from clothfit.report.findings import GOOD, PLAIN, WARN
from clothfit.report.log import Log, start_of
from clothfit.report.page import WEB, report_page
from clothfit.report.showing import BEFORE, residuals, view

LADDER = [{"model": "F", "values": 1, "rmse": 0.02, "holdout_rmse": 0.03, "seconds": 0.5},
          {"model": "L", "values": 33, "rmse": 0.001, "holdout_rmse": None, "seconds": 4.0}]  # fmt: skip
STEPS = {"delta": 0.01, "tried": [{"substeps": 2, "integrator": "bdf2", "rmse": 0.02, "seconds": 1.0}]}
PAIR = {"first": {"object": 0, "name": "stiffness", "index": 3}, "second": {"object": None, "name": "wind", "index": 2},
        "correlation": -0.98}  # fmt: skip


# --- residuals


def test_residuals_in_time_and_over_the_cloth_where_something_is_seen_and_compared():
    wanted = np.zeros((3, 2, 3))
    wanted[:, 1, 0] = [0.0, 3.0, 4.0]
    x = wanted + [0.0, 0.25, 0.0]  # a lag of 0.25 m upwards
    x[2] += 100.0  # after the fitted frames
    near = np.array([True, True, False])
    found = residuals(x, wanted, wanted[0], np.array([True, True]), near)
    assert found.mean[0].tolist() == [0.0, 0.25, 0.0]
    assert found.of_vertices.tolist() == [0.25, 0.25]
    assert found.travel == pytest.approx(np.sqrt(9.0 / 4.0))  # of 2 vertices in 2 frames
    wanted = np.full((2, 3, 3), np.nan)
    wanted[:, 0] = 1.0
    found = residuals(wanted + 1.0, wanted, np.ones((3, 3)), np.array([True, True, False]), np.ones(2, bool))
    assert found.of_vertices[0] == pytest.approx(np.sqrt(3.0))
    assert np.isnan(found.of_vertices[1:]).all()
    assert residuals(wanted, np.full_like(wanted, np.nan), wanted[0], np.ones(3, bool), np.ones(2, bool)).travel == 0.0


# --- tables of a summary, which is not trusted


def test_the_models_the_steps_and_the_correlations_are_tables():
    (models,) = findings.model_table({"ladder": LADDER})
    assert models["heads"] == ["model", "values", "error", "held-out error", "seconds"]
    assert models["rows"][0] == ["F one factor", ["1", 1.0], ["20 mm", 0.02], ["30 mm", 0.03], ["0.5", 0.5]]
    assert models["rows"][1][3] == "–"
    (tried,) = findings.steps({"step": STEPS})
    assert tried["rows"] == [[["2", 2.0], "bdf2", ["20 mm", 0.02], ["1", 1.0]]]
    (pairs,) = findings.correlations({"correlations": [PAIR]})
    assert pairs["rows"] == [["objects[0] stiffness [3]", "scene wind z", ["-0.98", -0.98]]]


@pytest.mark.parametrize("bad", [None, 3, "x", [], [3], [[]], {"tried": 1}, [{"first": 1, "second": {}}]])
def test_a_summary_that_cannot_be_read_gives_no_table(bad):
    summary = {"ladder": bad, "step": bad, "correlations": bad}
    assert findings.model_table(summary) + findings.steps(summary) + findings.correlations(summary) == []
    assert findings.value_name({"object": "x", "name": 5, "index": None}) == "scene 5"


@pytest.mark.parametrize(
    ("verdict", "level", "words"),
    [
        ({"model": "adequate", "unexplained": 0.001}, GOOD, "noise or rounding"),
        ({"model": "differs", "unexplained": 0.123}, WARN, "12 % of the motion is unexplained"),
        (None, PLAIN, ""), ({"model": "adequate", "unexplained": "x"}, PLAIN, ""), ([], PLAIN, ""),
    ],
)  # fmt: skip
def test_the_verdict_is_a_level_and_a_sentence(verdict, level, words):
    found, text = findings.judged({"verdict": verdict})
    assert found == level
    assert words in text


# --- the start of a fit, from a log


def test_the_start_of_a_fit_comes_from_its_summary_and_values_too_large_for_their_median_are_text():
    scene = load(even("LG", 4))
    count = len(scene.cloths[0].mass)
    masses = np.linspace(0.1, 0.2, count).tolist()
    blocks = [{"object": 0, "name": "mass", "mode": "L", "start": masses},
              {"object": 0, "name": "stiffness", "mode": "G", "start": 7.0}]  # fmt: skip
    found = start_of({"parameters": blocks}, scene)
    assert parameters(found).tolist() == pytest.approx([*masses, 7.0])
    assert start_of({"parameters": blocks[:1]}, scene) is None
    assert start_of({"parameters": [blocks[0], {**blocks[1], "start": [7.0, 8.0]}]}, scene) is None
    assert start_of({"parameters": [blocks[0], {**blocks[1], "start": -7.0}]}, scene) is None  # no stiffness
    assert start_of({"parameters": [[]]}, scene) is None
    assert findings.figure(findings.median(np.full(2, 1.5e308))) == "inf"  # a page is JSON, which has no such number
    assert findings.figure(2.5) == ["2.5", 2.5]


def test_what_to_do_next_is_what_has_not_been_done():
    """The hint of a stalled search comes first; a fit that chose by itself what to fit is not told to do so."""
    differs = {"status": "stalled", "verdict": {"model": "differs"}}
    auto, stalled = {"code": "auto", "text": "wind: fitted"}, {"code": "stalled", "text": "the search has stalled"}
    use = "se the fitted motion"
    assert findings.advice(differs, "f.json").startswith("Free more: --fit auto, --model auto; or u" + use)
    assert findings.advice({**differs, "hints": [auto]}, "f.json").startswith("U" + use)
    assert findings.advice({**differs, "hints": [auto, stalled]}, "f.json").startswith("The search has stalled; or u")
    fails = {"verdict": {"model": "fails"}, "hints": [auto, {"code": []}, 3]}
    assert findings.advice(fails, "f.json") == "Check unit, axes and held vertices."


# --- the motions beside the fitted one


@pytest.fixture(scope="module")
def three():
    """A scene, its target, a start and a fit of it."""
    return [load(even("nG", 12, springStiffness=[k] * 33)) for k in (30.0, 12.0, 29.0)]


@pytest.mark.slow
def test_the_motion_before_the_fit_stands_beside_it(three):
    truth, start, fitted = three
    target = simulate(truth, 12, 1e-10)
    show = view(start, fitted, target, others=[(BEFORE, start)])
    (before,) = show.companions
    own = simulate(start, 12, 1e-10)
    assert np.allclose(before.positions, own.positions, rtol=0, atol=1e-12)  # the same steps
    gap = ((own.positions - target.positions) ** 2).sum(axis=2)
    assert before.near.rmse == pytest.approx(np.sqrt(gap.mean()), rel=1e-9)
    assert before.rmse[1:] == pytest.approx(np.sqrt(gap.mean(axis=1))[1:], rel=1e-9)
    assert before.near.rmse > 5 * show.evaluation.fitted.rmse
    text = findings.headline(Log(start=start), show)["text"]
    percent = 100 * before.near.rmse / np.sqrt(((target.positions - target.positions[0]) ** 2).sum(axis=2).mean())
    assert f"before the fit {1000 * before.near.rmse:.3g} mm, {percent:.2g} %" in text


@pytest.mark.slow
def test_several_fits_of_a_target_stand_side_by_side(three):
    truth, start, fitted = three
    html = report_page(start, fitted, simulate(truth, 12), log=Log(start=start), others=[(truth, Log())])
    content = content_of(html)
    (table,) = (each for each in content["tables"] if each["id"] == "fits")
    assert [row[4][1] for row in table["rows"]] == [29.0, 12.0, 30.0]
    errors = [row[1][1] for row in table["rows"]]
    assert errors[2] < errors[0] < errors[1]
    assert [each["name"] for each in content["beside"]] == [BEFORE, truth.name]
    wild = load(even("nG", 12, integrationMethod=0, springStiffness=[5e5] * 33))
    target = as_motion(truth, simulate(truth, 12, 1e-10).positions)
    show = view(truth, fitted, target, others=[("wild.json", wild)])  # which diverges
    assert show.companions[0].near is None
    assert any("wild.json" in note and "diverged" in note for note in show.notes)
    assert len(report_page(truth, fitted, target, others=[(wild, Log())])) > 500_000


# --- colours


def luminance(hexadecimal):
    """Relative luminance of "#rrggbb" (WCAG 2.2)."""
    parts = np.array([int(hexadecimal[at : at + 2], 16) for at in (1, 3, 5)]) / 255.0
    linear = np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
    return float(linear @ [0.2126, 0.7152, 0.0722])


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_every_colour_of_the_scales_can_be_told_from_the_card(theme):
    script, style = ((WEB / name).read_text("utf-8") for name in ("colours.js", "page.css"))
    (part,) = re.findall(rf"{theme}: \{{(.*?)\}}", script, re.DOTALL)
    cards = re.findall(r"--card: (#\w{6})", style)
    card = luminance(cards[["light", "dark"].index(theme)])
    scales = [re.findall(r"#\w{6}", line) for line in part.splitlines() if "[" in line]
    assert [len(stops) for stops in scales] == [6, 5]
    for stops in scales:
        own = [luminance(stop) for stop in stops]  # what lies between two stops lies between their luminances
        assert min((max(each, card) + 0.05) / (min(each, card) + 0.05) for each in own) >= 3.0  # WCAG 1.4.11
    rising = [luminance(stop) for stop in scales[0]]
    assert rising == sorted(rising, reverse=theme == "light")  # legible in grey, too
