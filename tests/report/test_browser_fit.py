"""What a report shows of a fit, in a real browser: the verdict, the motions side by side, tables, files to keep."""

import csv
import io
from dataclasses import replace

import numpy as np
import pytest
from helpers.browsers import accessibility_script, differing, opened, pixels
from helpers.scenes import even

from clothfit import degrade, load, simulate
from clothfit.report.log import Log, Point
from clothfit.report.page import WEB, report_page

pytestmark = pytest.mark.slow  # starts processes

DESKTOP, PHONE = {"width": 1280, "height": 860}, {"width": 390, "height": 844}
SUMMARY = {
    "status": "limit", "objective": {"position": 1.0}, "verdict": {"model": "differs", "unexplained": 0.123},
    "warnings": ["=cmd() is text"], "hints": [{"code": "time_scale", "text": "the clock may be off"}],
    "ladder": [{"model": "F", "values": 1, "rmse": 0.02, "holdout_rmse": 0.03, "seconds": 0.5},
               {"model": "L", "values": 33, "rmse": 0.01, "holdout_rmse": 0.04, "seconds": 2.5}],
    "parameters": [
        {"object": 0, "name": "stiffness", "mode": "L", "at_bound": [4], "interval": [[11.0, 13.0]] * 33},
        {"object": None, "name": "wind", "mode": "G", "interval": [[0.5, 0.75], [-0.1, 0.1], [1.5, 2.5]]},
    ],
}  # fmt: skip
TEXTS = """() => [...document.querySelectorAll("svg.chart")].map((chart) => {
  const box = chart.closest(".card").getBoundingClientRect();
  return [...chart.querySelectorAll("text")].filter((text) => text.textContent.trim()).map((text) => {
    const { left, right, top, bottom } = text.getBoundingClientRect();
    return { text: text.textContent, left, right, top, bottom, inside: left >= box.left && right <= box.right };
  });
})"""


def scene(stiffness, wind):
    """A hanging cloth in wind, whose stiffnesses, wind and gravity are to be found."""
    return even("nL", 30, springStiffness=stiffness, windVel=dict(zip("xyz", wind, strict=True)),
                fit={"windVel": "G", "gravity": "G"})  # fmt: skip


def read(download):
    """The rows of a CSV file that the page saves."""
    with open(download.path(), encoding="utf-8-sig", newline="") as file:
        return list(csv.reader(io.StringIO(file.read())))


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    start = load(scene([40.0] * 33, (0.1, 0.0, 1.0)))
    truth = load(scene([12.0] * 33, (0.6, 0.0, 2.0)))
    fitted = load(scene(np.geomspace(0.5, 2e3, 33).tolist(), (0.62, 0.0, 2.1)))
    target = replace(degrade(simulate(truth), noise=0.002), name="<b>shot</b>.pc2")
    log = Log([Point(i + 1, 7.0 / 3**i, 0.1, 0.1 * i) for i in range(9)], SUMMARY, start=start)
    fits = replace(fitted, name="one.json"), [(replace(truth, name="two.json"), Log())]
    page = tmp_path_factory.mktemp("report") / "fit.html"
    page.write_bytes(report_page(start, fits[0], target, log=log, others=fits[1], commands=["clothfit report"]))
    return page


@pytest.fixture(scope="module")
def shared(started, path):
    with opened(started, path, DESKTOP) as both:
        assert not both[0].locator("#residuals").is_visible()  # folded
        both[0].locator(".more > summary").click()
        yield both


@pytest.fixture
def page(shared):
    page, said = shared
    page.evaluate("document.querySelector('#modes [value=plain]').click(); clothfit.player.goToFrame(20)")
    yield page
    assert said == []


def rows(page, name):
    """The texts of a table's rows, its heads first."""
    return [row.locator("th, td").all_inner_texts() for row in page.locator(f"#table-{name} tr").all()]


def test_the_verdict_is_the_first_thing_in_the_page_with_warnings_under_it_and_errors_in_percent(page):
    box, picture = (page.locator(where).bounding_box() for where in ("#verdict", "#stage"))
    assert box["y"] + box["height"] <= picture["y"]
    text = page.locator("#verdict .line").inner_text()
    assert text.startswith("The model differs from the target: 12 % of the motion is unexplained. The fit ended")
    assert page.locator("#verdict .next").inner_text().startswith("Next: Go on from here with --resume")
    assert "warn" in page.locator("#verdict").get_attribute("class")
    listed = page.locator("#verdict li").all_inner_texts()
    assert "objects[0] stiffness: 1 value is at a bound of the fit (--bounds)" in listed
    assert {"hint: the clock may be off", "=cmd() is text"} <= set(listed)
    assert " % of the travel; before the fit " in text
    assert "% of the travel" in page.locator("#readout").inner_text()
    assert "of the distance travelled" in page.locator("#headline").inner_text()
    assert "cost, m²" in page.locator("svg.chart[aria-label^='Best cost']").inner_html()


def test_three_motions_stand_side_by_side_and_can_be_left_out(page):
    names = page.locator(".pane-name b").all_inner_texts()
    assert names == ["fitted", "before the fit", "two.json"]
    places = [each.bounding_box() for each in page.locator(".pane-name").all()]
    assert [round(each["x"] - places[0]["x"]) for each in places] == [
        round(k * places[0]["width"]) for k in range(3)
    ]  # fmt: skip
    three = pixels(page)
    page.locator("#chips .pane").nth(0).click()
    page.locator("#chips .pane").nth(1).click()
    assert page.locator(".pane-name").count() == 0
    assert differing(three, pixels(page)) > three.size / 300
    page.locator("#chips .pane").nth(0).click()
    page.locator("#chips .pane").nth(1).click()
    assert page.locator(".pane-name b").all_inner_texts() == names


def test_each_pane_shows_its_own_motion(page):
    gaps = page.evaluate("""() => clothfit.panes.map(({ cloth }) =>
      Math.max(...cloth.positions.map((x, i) => Math.abs(x - clothfit.target.positions[i]))))""")
    assert gaps[2] < 0.02  # the true one, 2 mm of noise
    assert gaps[1] > 5 * gaps[2]
    assert page.evaluate("new Set(clothfit.panes.map(({ shading }) => shading.most)).size") == 1  # colours agree


def test_the_fits_are_compared_in_a_table_and_in_the_chart(page):
    heads, *fits = rows(page, "fits")
    assert [row[0] for row in fits] == ["one.json", "before the fit", "two.json"]
    assert heads[:4] == ["motion", "RMSE", "of travel", "largest"]
    assert all(row[2].endswith("%") for row in fits)
    assert page.locator("svg.live path.line").count() == 4  # error and largest; and the error of two beside it
    assert "two.json" in page.locator(".key").first.inner_text()


def test_residuals_are_shown_over_the_cloth_and_in_time(page):
    assert page.locator("#residuals canvas.map").count() == 1
    colours = page.evaluate("""() => { const map = document.querySelector("#residuals canvas"),
      found = map.getContext("2d").getImageData(0, 0, map.width, map.height).data;
      return new Set(Array.from({ length: found.length / 4 }, (_, i) => found.slice(4 * i, 4 * i + 4).join())).size;
    }""")
    assert colours > 8  # more than one value
    assert page.locator("#drift path.line").count() == 3


@pytest.mark.parametrize("size", [DESKTOP, PHONE], ids=["desktop", "phone"])
def test_no_label_of_an_axis_touches_another(page, size):
    page.set_viewport_size(size)
    for texts in page.evaluate(TEXTS):
        for i, a in enumerate(texts):
            assert a["inside"], a
            for b in texts[:i]:
                apart = a["left"] >= b["right"] or b["left"] >= a["right"]
                # boxes of lines of text are a little higher than their letters
                assert apart or a["top"] >= b["bottom"] - 1.5 or b["top"] >= a["bottom"] - 1.5, (a, b)
    page.set_viewport_size(DESKTOP)


def test_a_table_is_saved_as_csv_that_no_spreadsheet_runs(page):
    with page.expect_download() as got:
        page.locator("#table-values .tool", has_text="CSV").click()
    assert got.value.suggested_filename == "values.csv"
    heads, *found = read(got.value)
    assert heads[:3] == ["value", "start", "fitted"]
    (gravity,) = (row for row in found if row[0] == "scene gravity y")
    assert float(gravity[2]) == pytest.approx(-9.81)
    text = page.evaluate("import('clothfit/save').then(({ csv }) => csv([['=1+1', '-2', 'a\"b', -3.5, null]]))")
    assert text == "'=1+1,-2,\"a\"\"b\",-3.5,\r\n"


def test_the_numbers_of_a_chart_are_saved_as_csv(page):
    with page.expect_download() as got:
        page.locator(".card", has=page.locator("svg.live")).locator(".tool", has_text="CSV").click()
    heads, *found = read(got.value)
    assert heads == ["time_s", "rmse_m", "largest_m", "rmse_m before the fit", "rmse_m two.json"]
    assert len(found) == 30
    assert [float(row[0]) for row in found[:3]] == pytest.approx([0.0, 0.02, 0.04])


@pytest.mark.parametrize("where", ["#shot", ".card:has(svg.live) .tool:text('PNG')", "#residuals .tool:text('PNG')"])
def test_pictures_are_saved_as_png(page, where):
    from PIL import Image

    with page.expect_download() as got:
        page.locator(where).click()
    with Image.open(got.value.path()) as image:
        shown = np.asarray(image.convert("RGB"), dtype=int)
    assert min(shown.shape[:2]) > 300
    assert (np.abs(shown - np.median(shown, axis=(0, 1))).max(axis=2) > 24).mean() > 0.003  # not a blank sheet


def test_a_table_is_copied(page):
    page.context.grant_permissions(["clipboard-read", "clipboard-write"])
    page.locator("#table-ladder .tool", has_text="Copy").click()
    page.locator("#table-ladder .tool", has_text="Copied").wait_for()
    copied = page.evaluate("navigator.clipboard.readText()")
    assert copied.splitlines()[1].split("\t") == ["F one factor", "1", "0.02", "0.03", "0.5"]


def test_a_phone_shows_the_fit_alone_first_and_nothing_sideways(started, path):
    with opened(started, path, PHONE) as (page, said):
        assert page.evaluate("document.documentElement.scrollWidth") == PHONE["width"]
        assert page.locator("#canvas").bounding_box()["width"] > 300
        assert [each.get_attribute("aria-pressed") for each in page.locator("#chips .pane").all()] == ["false", "false"]
        chips, readout = (page.locator(where).bounding_box() for where in ("#chips", "#readout"))
        assert chips["y"] + chips["height"] <= readout["y"]
        assert said == []


def test_the_parts_of_the_page_stay_small():
    own = sum(path.stat().st_size for path in WEB.iterdir() if path.is_file())
    whole = sum(path.stat().st_size for path in WEB.rglob("*") if path.is_file())
    assert own < 150_000
    assert whole < 720_000  # in each page; three.js is four fifths of it


@pytest.mark.parametrize(("scheme", "size"), [("light", PHONE), ("dark", DESKTOP)], ids=["phone", "desktop"])
def test_axe_finds_no_error(started, path, scheme, size):
    script = accessibility_script()
    with opened(started, path, size) as (page, _):
        page.emulate_media(color_scheme=scheme)
        page.locator(".keys summary").click()
        page.evaluate(script)
        found = page.evaluate("axe.run(document)")
    assert [(each["id"], each["nodes"][0]["html"]) for each in found["violations"]] == []
    assert {"color-contrast", "button-name", "image-alt", "region"} & {each["id"] for each in found["passes"]} >= {
        "color-contrast", "button-name", "region",
    }  # fmt: skip
