"""The live page in a real browser, from end to end: play, tune, pull, fit, save."""

import json

import numpy as np
import pytest
from helpers.browsers import PATIENCE, browser, differing, pixels
from helpers.scenes import document, even

from clothfit.fit.estimate import record_target
from clothfit.scene.scene import dumps, load

pytest.importorskip("tornado")

from clothfit.live.engine import Engine
from clothfit.live.server import Serving

pytestmark = pytest.mark.slow

SIZE = {"width": 1000, "height": 700}
LONG = 600_000  # ms: the process of a fit may have to compile


def scene():
    return load(even("nF", 30, title="<b>a cloth</b>"))


@pytest.fixture(scope="module")
def target():
    with Engine(scene()) as engine:  # what has to be compiled is compiled here
        engine.step()
    return record_target(scene())


@pytest.fixture
def serving(target):
    with Serving(scene(), target) as server:
        yield server


@pytest.fixture(scope="module")
def started():
    with browser() as made:
        yield made


@pytest.fixture
def page(started, serving):
    """The page of a scene that stands at its start, with its target."""
    context = started.new_context(viewport=SIZE, reduced_motion="reduce", has_touch=True)
    page, said = context.new_page(), []
    page.set_default_timeout(PATIENCE)
    page.on("console", lambda message: said.append(f"{message.type}: {message.text}"))
    page.on("pageerror", lambda error: said.append(f"error: {error}"))
    page.goto(serving.address)
    page.wait_for_selector("html[data-ready=yes]", state="attached")
    page.evaluate("clothfit.link.ask('pause').then(() => clothfit.link.ask('reset'))")
    until(page, "clothfit.page.picture?.aimed && clothfit.page.drawn.number === 0")
    yield page
    assert said == []  # no error, no warning, whatever the test did
    context.close()


def until(page, condition):
    """Wait until a condition holds; Playwright's own way asks for `eval`, which the page forbids."""
    for _ in range(LONG // 50):
        if page.evaluate(condition):
            return
        page.wait_for_timeout(50)
    seen = page.evaluate("({ status: clothfit.page.status, drawn: clothfit.page.drawn?.number })")
    raise AssertionError(f"{condition}: never; {seen}")


def height(page):
    """The mean height of the vertices that the page shows, m."""
    return page.evaluate("""() => {
      const x = clothfit.page.picture.live.positions;
      return x.reduce((sum, value, i) => sum + (i % 3 === 1 ? value : 0), 0) / (x.length / 3);
    }""")


def at_frame(page, number):
    until(page, f"clothfit.page.drawn.number === {number}")


def steps(page, n):
    """The height n steps after the start."""
    page.evaluate("clothfit.link.ask('reset')")
    at_frame(page, 0)
    page.evaluate(f"clothfit.link.ask('step', {{ n: {n} }})")
    at_frame(page, n)
    return height(page)


def saved(page, serving):
    with page.expect_download() as download:
        page.locator("#save").click()
    return load(str(download.value.path()))


def test_names_are_text_and_the_cloth_is_drawn(page):
    assert page.locator("h1").inner_text() == "<b>a cloth</b>"
    there = pixels(page)
    page.keyboard.press("c")
    page.keyboard.press("t")
    assert differing(there, pixels(page)) > there.shape[0] * there.shape[1] / 100


def test_the_keyboard_plays_steps_and_goes_back(page):
    page.keyboard.press("ArrowRight")
    at_frame(page, 1)
    page.keyboard.press("Space")
    until(page, "clothfit.page.drawn.number > 20")
    page.keyboard.press("Space")
    until(page, "!clothfit.page.status.running")
    assert height(page) < -0.01
    page.keyboard.press("Home")
    at_frame(page, 0)


def test_a_slider_changes_the_motion_and_undo_brings_it_back(page, serving):
    before = steps(page, 20)
    slider = page.locator("#air input").first
    slider.focus()
    for _ in range(3):
        page.keyboard.press("PageUp")
    until(page, "clothfit.page.status.undo > 0 && !clothfit.page.dials[0].sender.busy")
    assert steps(page, 20) > before + 0.01  # it falls more slowly
    assert saved(page, serving).cloths[0].damping > scene().cloths[0].damping
    while left := page.evaluate("clothfit.page.status.undo"):
        page.locator("#undo").click()
        until(page, f"clothfit.page.status.undo < {left}")  # else a click may come when there is nothing left
    assert steps(page, 20) == before
    assert dumps(saved(page, serving)) == dumps(scene())


def test_a_vertex_is_pulled_by_the_mouse(page):
    box = page.locator("#canvas").bounding_box()
    place = page.evaluate("""() => {
      const { stage, live } = clothfit.page.picture, i = live.positions.length - 3;
      const at = stage.orbit.centre.clone().set(...live.positions.slice(i, i + 3)).project(stage.camera);
      return [(at.x + 1) / 2, (1 - at.y) / 2];
    }""")
    x, y = box["x"] + place[0] * box["width"], box["y"] + place[1] * box["height"]
    azimuth = page.evaluate("clothfit.page.picture.stage.orbit.azimuth")
    page.mouse.move(x, y)
    assert page.locator("#stage.reaching").count() == 1  # the vertex is under the pointer
    page.evaluate("clothfit.page.status.running = true")  # what the page has heard may be older than the last pause
    page.mouse.down()
    page.mouse.move(x, y - 150, steps=5)
    until(page, "clothfit.page.drawn.number > 30")
    last = page.evaluate("clothfit.page.picture.live.positions[clothfit.page.picture.live.positions.length - 2]")
    page.mouse.up()
    assert last > 0.2  # it was pulled upwards
    assert page.evaluate("clothfit.page.picture.stage.orbit.azimuth") == azimuth  # and the view was not turned


def test_a_fit_from_tuned_values_finds_those_of_the_file(page, serving):
    page.evaluate("clothfit.link.ask('set', { factors: { stiffness: 3 } }).then(() => clothfit.link.ask('play'))")
    until(page, "clothfit.page.dials.some((dial) => dial.output.textContent === '3 ×')")
    page.evaluate("clothfit.link.ask('pause')")  # else it is drawn for as long as the fit compiles
    assert page.locator("#fit-stiffness").input_value() == "F"
    page.locator("#fit").click()
    until(page, "document.querySelector('#fit-text').textContent.startsWith('converged')")
    assert page.locator("#cost svg").count() == 1
    found = saved(page, serving)
    assert np.allclose(found.cloths[0].stiffness, scene().cloths[0].stiffness, rtol=1e-6)
    assert np.array_equal(found.cloths[0].mass, scene().cloths[0].mass)


def test_another_scene_is_opened(page):
    other = json.dumps(document(title="another"))
    page.locator("#file").set_input_files({"name": "b.json", "mimeType": "application/json", "buffer": other.encode()})
    until(page, "document.querySelector('h1').textContent === 'another'")
    page.locator("#file").set_input_files({"name": "c.json", "mimeType": "application/json", "buffer": b"{"})
    until(page, "document.querySelector('#readout').textContent.includes('line 1')")


def test_it_is_dark_or_light_and_fits_a_telephone(page):
    light = page.evaluate("document.documentElement.dataset.theme")
    page.keyboard.press("d")
    assert page.evaluate("document.documentElement.dataset.theme") != light
    page.set_viewport_size({"width": 360, "height": 720})
    assert page.evaluate("document.documentElement.scrollWidth") <= 360
    assert page.locator("#fit").bounding_box()["x"] >= 0
    assert page.locator("#canvas").bounding_box()["y"] < page.locator("#save").bounding_box()["y"]  # the cloth first


def test_keys_are_posed_and_forces_reach_them(page):
    page.evaluate("clothfit.link.ask('step', { n: 10 })")
    at_frame(page, 10)
    page.locator("#key-of").select_option("all")
    page.locator("#key-time").fill("0.3")
    page.locator("#key-add").click()
    assert page.locator("#key-list li").count() == 1
    page.locator("#control").click()
    until(page, "document.querySelector('#control-text').textContent.includes('missed by')")


def test_colours_of_stiffnesses_follow_their_slider(page):
    page.keyboard.press("4")
    before = page.locator("#legend").inner_text()
    page.evaluate("clothfit.link.ask('set', { factors: { stiffness: { all: 2 } } })")
    until(page, f"document.querySelector('#legend').innerText !== {json.dumps(before)}")
    assert np.allclose(page.evaluate("[...clothfit.page.scene.mesh.stiffness]"), 60.0, rtol=1e-6)  # twice 30, float32
    page.evaluate("clothfit.link.ask('undo')")
    until(page, f"document.querySelector('#legend').innerText === {json.dumps(before)}")
    page.keyboard.press("1")


def test_what_was_open_plays_on_while_a_scene_is_loaded_and_the_load_can_be_given_up(page, serving, monkeypatch):
    held = []

    class Held:
        def __init__(self, name, heard, **arguments):
            held.append(name)

        def kill(self):
            held.append("killed")

    monkeypatch.setattr("clothfit.live.task.Task", Held)
    page.keyboard.press("Space")
    page.set_input_files("#file", {"name": "other.json", "mimeType": "application/json", "buffer": b"{}"})
    until(page, "!document.querySelector('#give-up').hidden")
    seen = page.evaluate("clothfit.page.packet.number")
    until(page, f"clothfit.page.packet.number !== {seen}")
    page.locator("#give-up").click()
    until(page, "document.querySelector('#readout').textContent.includes('cancelled')")
    assert held == ["load", "killed"]
    until(page, "document.querySelector('#give-up').hidden")  # the answer and the end of the load are two messages
