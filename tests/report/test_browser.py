"""Reports in a real browser, opened from disk with the network off."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.browsers import differing, opened, pixels
from helpers.scenes import even, sphere
from helpers.surfaces import block, body
from scipy.spatial.transform import Rotation

from clothfit import degrade, load, report_page, simulate
from clothfit.pictures.solids import solids
from clothfit.report.log import Log, Point

pytestmark = pytest.mark.slow  # starts processes

HOSTILE = "</script><img src=x onerror=\"window.pwned=1\"><script>window.pwned=2</script>{{content}}&amp;"
FRAMES = 30
PLAYED = """() => new Promise((done) => {
  const look = () => (clothfit.player.frame > 1 ? done() : requestAnimationFrame(look));
  look();
})"""
LEGENDS = {
    "error": "distance to the target, m", "mass": "mass of a vertex, kg", "stiffness": "N/m", "strain": "strain",
}  # fmt: skip


def scene(**fields):
    """A hanging cloth over a ball, in wind."""
    ball = sphere(0.6, pos={"x": 1.5, "y": -2.2, "z": 1.5})
    made = even("LL", FRAMES, title=HOSTILE, colliders=[ball], windVel={"x": 0.0, "y": 0.0, "z": 2.0}, **fields)
    return load(made)


@pytest.fixture(scope="module")
def truth():
    return scene()


@pytest.fixture(scope="module")
def fitted():
    return replace(scene(springStiffness=[12.0] * 33), name="<b>fitted</b>.json")


@pytest.fixture(scope="module")
def path(truth, fitted, tmp_path_factory):
    verdict = {"model": "adequate", "unexplained": 0.0}
    summary = {"status": "converged", "verdict": verdict, "parameters": [
        {"object": 0, "name": "stiffness", "mode": "L", "interval": [[11.0, 13.0]] * 33}
    ]}  # fmt: skip
    log = Log([Point(i + 1, 10.0 / 2**i, 0.1, 0.1 * i) for i in range(12)], summary)
    page = tmp_path_factory.mktemp("report") / "report.html"
    page.write_bytes(report_page(truth, fitted, frames=60, log=log, commands=[f"clothfit report '{HOSTILE}'"]))
    return page


@pytest.fixture(scope="module")
def shared(started, path):
    with opened(started, path) as both:
        both[0].locator(".more > summary").click()
        yield both


@pytest.fixture
def page(shared):
    """The page as it begins."""
    page, said = shared
    page.evaluate("document.querySelector('#modes [value=plain]').click(); clothfit.player.pause()")
    page.evaluate("document.activeElement.blur(); clothfit.player.goToFrame(20)")
    yield page
    assert said == []  # no error, no warning, no request, whatever the test did


def frame(page):
    """The frame that the page shows."""
    return int(page.locator("#scrub").input_value())


def test_hostile_names_are_text(page):
    assert page.locator("h1").inner_text() == HOSTILE
    assert HOSTILE in page.locator(".commands").inner_text()
    assert "<b>fitted</b>.json" in page.locator("#subtitle").inner_text()
    assert page.evaluate("[typeof window.pwned, document.images.length]") == ["undefined", 0]


def test_the_cloth_is_seen_and_moves(page):
    there = pixels(page)
    page.keyboard.press("c")
    page.keyboard.press("t")
    without = pixels(page)
    page.keyboard.press("c")
    page.keyboard.press("t")
    size = there.shape[0] * there.shape[1]
    assert differing(there, without) > size / 50  # a cloth, not a line
    page.evaluate("clothfit.player.goToFrame(0)")
    assert differing(there, pixels(page)) > size / 50
    page.evaluate("clothfit.player.goToFrame(20)")
    assert differing(there, pixels(page)) < size / 500  # but for the button that has been pressed


def test_the_target_is_a_green_cloth_over_the_other(page):
    def green(picture):
        red, much, blue = (picture[:, :, c] for c in range(3))
        return int(((much > red + 20) & (much > blue + 20)).sum())

    there = pixels(page)
    page.keyboard.press("t")
    without = pixels(page)
    page.keyboard.press("t")
    assert green(there) > green(without) + 200
    assert page.locator("#show-target").get_attribute("aria-pressed") == "true"


def test_the_keyboard_plays_and_scrubs(page):
    def after(key):
        page.keyboard.press(key)
        return frame(page)

    assert [after(key) for key in ("Home", "ArrowRight", "ArrowRight", "ArrowLeft")] == [0, 1, 2, 1]
    assert [after(key) for key in ("End", "PageUp")] == [59, 49]
    page.locator("#scrub").focus()
    assert [after("ArrowLeft"), after("Home")] == [48, 0]  # once each, though the slider knows these keys as well
    page.keyboard.press("Space")
    page.evaluate(PLAYED)
    page.keyboard.press("Space")
    assert page.evaluate("clothfit.player.playing") is False
    assert page.locator("#play").get_attribute("aria-label") == "Play (space)"


def test_keys_move_the_view_and_f_brings_it_back(page):
    before = pixels(page)
    for key in ("+", "Shift+ArrowLeft", "Shift+ArrowUp"):
        page.keyboard.press(key)
    assert differing(before, pixels(page)) > 1000
    page.keyboard.press("f")
    assert differing(before, pixels(page)) < 100


def test_every_shading_colours_the_cloth_and_has_a_legend(page):
    plain = pixels(page)
    for key, (mode, words) in enumerate(LEGENDS.items(), 2):
        page.keyboard.press(str(key))
        assert page.locator(f"#modes [value={mode}]").is_checked()
        assert words in page.locator("#legend").inner_text()
        assert differing(plain, pixels(page)) > 1000


def test_the_chart_of_errors_leads_to_a_frame(page):
    chart = page.locator("svg.live")
    chart.scroll_into_view_if_needed()
    box = chart.bounding_box()
    page.mouse.click(box["x"] + 0.9 * box["width"], box["y"] + 0.5 * box["height"])
    assert 45 < frame(page) < 60
    page.evaluate("scrollTo(0, 0)")


def test_what_the_page_unpacks_is_what_was_simulated(page, fitted):
    told = page.evaluate("(clothfit.fitted.move(20, 0), Array.from(clothfit.fitted.positions))")
    step = page.evaluate("clothfit.fitted.motion.step")
    x = simulate(fitted, 21, 1e-10).positions[20] * [-1.0, 1.0, 1.0]  # the scene is left-handed
    gap = np.abs(np.reshape(told, (-1, 3)) - x)
    assert (gap <= 0.5 * np.array(step) + 1e-6).all()  # half a step of the grid, and the rounding of float32


def test_charts_and_maps_are_there(page):
    assert page.locator("svg.chart").count() == 7  # error, mean residual, cost, and two of each of two kinds
    assert page.locator("canvas.map").count() == 3  # residuals, and one of each kind
    assert page.locator("path.band").count() == 1  # intervals are known of the stiffnesses only


def test_a_target_with_gaps_shows_what_was_seen(started, truth, fitted, tmp_path):
    target = degrade(simulate(truth), noise=0.002, observed=0.5, every=2)
    path = tmp_path / "gaps.html"
    path.write_bytes(report_page(truth, fitted, target))
    with opened(started, path) as (page, said):
        kept = page.evaluate("[clothfit.target.faces.drawRange.count, clothfit.target.dots.drawRange.count]")
        assert kept[0] < 54  # 18 faces
        assert 0 < kept[1] < 16
        assert page.locator("#scrub").get_attribute("max") == "14"
        assert said == []


def test_what_has_keys_moves_with_them_colliders_of_every_shape_pins_and_the_arrow_of_the_wind(started, tmp_path):
    zero = {"x": 0, "y": 0, "z": 0}
    turn = {"times": [0, 1], "values": [zero, {"x": 9, "y": 80, "z": 3}]}
    way = {"times": [0, 1], "values": [zero, {"x": 1, "y": -0.5, "z": 0.25}]}
    common = {"pos": {"x": 1.5, "y": -2.2, "z": 1.5}, "rot": {"x": 0, "y": 30, "z": 70}}
    ball = sphere(0.6, pos=common["pos"], posKeys=way)
    common["scale"] = {"x": 1, "y": 2, "z": 1}
    shapes = [{"type": 0, **common, "rot": zero}, {"type": 2, **common, "radius2": 0.1, "posKeys": way}]
    shapes.append({"type": 3, **common, "posKeys": way, "rotKeys": turn})
    points, faces = block((0.1, 0.05, 0.1))  # on a grid of 16 bits finer than the numbers are compared
    np.savez(tmp_path / "grow.npz", positions=np.stack([points, 1.5 * points]), times=np.array([0.0, 1.0]))
    bent = {"rotKeys": turn, "motion": {"file": str(tmp_path / "grow.npz")}}
    shapes.append({**body((points, faces)), **common, **bent})
    wind = {"times": [0, 0.1], "values": [{"x": 1, "y": 0, "z": 0}, {"x": 0, "y": 0, "z": 4}]}
    document = even("nG", FRAMES, colliders=[*shapes, ball], planes="solid", windVelKeys=wind)
    document["objects"][0]["pins"] = [{"vertices": [0], "posKeys": way}]
    made = load(document)
    path = tmp_path / "moving.html"
    path.write_bytes(report_page(made, made))
    with opened(started, path) as (page, said):
        page.evaluate("clothfit.player.pause(); clothfit.player.goToFrame(10)")
        time = page.evaluate("clothfit.player.time")
        at, flipped = time * np.array([1.0, -0.5, 0.25]), np.array([-1.0, 1.0, 1.0])  # the page's axes: right-handed
        centre = page.evaluate("clothfit.stage.balls[0].position.toArray()")
        pin = page.evaluate("Array.from(clothfit.stage.pinBalls.instanceMatrix.array.slice(12, 15))")
        np.testing.assert_allclose(centre, flipped * ([1.5, -2.2, 1.5] + at), atol=1e-9)
        np.testing.assert_allclose(pin, flipped * at, atol=1e-3)  # positions are packed into 16 bits
        true = solids(made, np.array([0.0, time]), simulate(made).positions)
        shown = page.evaluate("""clothfit.stage.solids.map((mesh) => {
          mesh.updateMatrixWorld();
          const at = mesh.geometry.getAttribute("position").clone().applyMatrix4(mesh.matrixWorld);
          return [Array.from(at.array), Array.from(mesh.geometry.getAttribute("normal").array)];
        })""")
        assert len(shown) == 4
        for own, (points, normals) in zip(true[1:], shown[1:], strict=True):
            np.testing.assert_allclose(np.reshape(points, (-1, 3)) * flipped, own.at(1), atol=1e-5)  # of 32 bits
            outward = (np.reshape(normals, (-1, 3)) * flipped * own.points).sum(axis=1)
            assert (outward > 0).all()  # both shapes are convex, and their origin is within
        arrow = page.evaluate("[...clothfit.stage.arrow.quaternion.toArray(), clothfit.stage.arrow.scale.x]")
        np.testing.assert_allclose(Rotation.from_quat(arrow[:4]).apply([0, 1, 0]), [0, 0, 1], atol=1e-9)
        assert arrow[4] == pytest.approx(1.0)
        assert said == []
