"""`control --report`: what the page of a controlled motion holds, and what a browser makes of it."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.browsers import differing, opened, pixels
from helpers.physics import scene
from helpers.scenes import cloth
from helpers.unpacking import unpacked_positions

from clothfit import Forces, Key, simulate
from clothfit.control.control import Control, controlled_motion, miss, reached
from clothfit.optimise.status import Status
from clothfit.report import control_contents
from clothfit.report.control_contents import control_content
from clothfit.report.page import page as made_page

pytestmark = pytest.mark.slow  # starts processes

STEPS, H = 24, 0.02
FREE = [3, 4, 5, 6, 7, 8, 9, 10, 11]


@pytest.fixture(scope="module")
def found():
    """A course with a key of all that is reached, one of two vertices and a mean that are missed; and its search."""
    made = scene(cloth(), delta=H, optimizationIterations=STEPS + 1, title="</script><b>led</b>")
    u = np.zeros((STEPS, 12, 3))
    u[:, FREE] = [0.3, 0.1, -0.2]
    u[:, 11] *= np.linspace(0.0, 2.0, STEPS)[:, None]
    pushed = made.with_forces(Forces(H * np.arange(STEPS), u))
    motion = simulate(pushed)
    x = motion.positions
    every = np.arange(12, dtype=np.int32)
    keys = [
        Key(10, 0, every, x[10], velocities=(x[10] - x[9]) / H + [3.0, 0, 0]),
        Key(STEPS, 0, np.array([8, 9], np.int32), x[STEPS, [8, 9]] + [0, 0.3, 0.4], hard=True),
        Key(STEPS, 0, every, x[STEPS].mean(axis=0)[None] + [0.2, 0, 0], share=np.full(12, 1 / 12)),
    ]
    over = controlled_motion(made, pushed, keys, motion)
    near = tuple(reached(key, motion, made) for key in keys)
    free = tuple(miss(key, over.free, made) for key in keys)
    effort = over.effort.sum()
    return over, Control(Status.LIMIT, made, pushed.forces, motion, near, free, effort, 0.5, 7, 1.5, 2)


def test_what_the_page_tells(found):
    over, ended = found
    shows = control_content(over, ended)
    assert shows["headline"]["level"] == "warn"
    assert "2 of 3 keys are missed, at 0.48 s by 500 mm" in shows["headline"]["text"]
    assert "ended at its limit" in shows["headline"]["text"]
    assert shows["headline"]["warnings"] == ["2 forces are at the bound (--most)"]
    control = shows["control"]
    assert control["times"] == pytest.approx([0.2, 0.48])
    assert control["due"] == [10, STEPS]
    forces = unpacked_positions(control["forces"])
    np.testing.assert_allclose(forces[:-1], over.forces[:-1], atol=1e-4 * np.abs(over.forces).max())  # of its grid
    assert sum(control["chart"]["effort"]) == pytest.approx(ended.effort, rel=1e-5)  # six digits are kept
    (table,) = shows["tables"]
    assert table["heads"] == ["key", "asks for", "without", "with", "reached", "velocity off", "weight"]
    first, second, third = table["rows"]
    assert (first[1], first[4], first[5][0]) == ("all vertices", "yes", "3 m/s")
    assert (second[1], second[4], second[6]) == ("2 of 12 vertices", "missed", "hard")
    assert (third[1], third[5]) == ("mean of 12", "–")
    assert second[3][1] == pytest.approx(0.5, rel=1e-9)
    curve = shows["curve"]["rmse"]
    assert curve[STEPS] == pytest.approx(0.5, rel=1e-5)  # of two keys of one time the farther one
    assert curve[10] == 0.0


def test_frames_of_keys_are_shown_however_few_frames_are_and_forces_where_there_are_some(found, monkeypatch):
    over, ended = found
    monkeypatch.setattr(control_contents, "MOST_POSITIONS", 3 * 12 * 5)
    shows = control_content(over, ended)
    times = shows["motion"]["times"]
    assert len(times) < 10
    assert [times[frame] for frame in shows["control"]["due"]] == pytest.approx([0.2, 0.48])
    assert "not every frame is shown" in " ".join(shows["notes"])
    assert len(shows["control"]["chart"]["times"]) == STEPS + 1
    still = replace(over, forces=np.zeros_like(over.forces), effort=np.zeros_like(over.effort))
    shows = control_content(still, ended)
    assert "forces" not in dict(shows["facts"])
    assert shows["control"]["largest"] == 0.0


@pytest.fixture(scope="module")
def page(found, started, tmp_path_factory):
    path = tmp_path_factory.mktemp("page") / "control.html"
    path.write_bytes(made_page(control_content(*found), ["clothfit control"], [("scene.json", "0" * 64)]))
    with opened(started, path) as (page, said):
        yield page
        assert said == []  # no error, no request


def test_keys_and_forces_are_seen_and_can_be_hidden(page):
    assert page.locator("h1").inner_text() == "</script><b>led</b>"
    page.evaluate("clothfit.player.goToFrame(5)")
    there = pixels(page)
    for key in "at":  # forces, keys
        page.keyboard.press(key)
        assert differing(there, pixels(page)) > 100
        page.keyboard.press(key)
    assert differing(there, pixels(page)) == 0


def test_the_next_key_is_the_stronger_ghost(page):
    shares = "clothfit.over.veils.map((veil) => veil.share)"
    page.evaluate("clothfit.player.goToFrame(10)")
    first, second = page.evaluate(shares)
    assert first == 1 > second
    page.evaluate("clothfit.player.goToFrame(11)")
    assert page.evaluate(shares) == [second, 1]
    assert page.evaluate("clothfit.over.balls.map((group) => group.children.length)") == [0, 1]


def test_an_arrow_stands_on_its_vertex_along_the_force(page, found):
    over, _ = found
    page.evaluate("clothfit.player.goToFrame(20)")
    vertices, shafts, scale, head = page.evaluate("""(() => {
      const { vertices, shafts, scale, head } = clothfit.controls;
      return [vertices, Array.from(shafts.instanceMatrix.array), scale, head]; })()""")
    assert vertices == FREE
    mirrored = np.array([-1.0, 1.0, 1.0])  # the page's axes are right-handed
    for vertex, matrix in zip(vertices, np.reshape(shafts, (-1, 4, 4)), strict=True):
        force = over.forces[20, vertex] * mirrored
        np.testing.assert_allclose(matrix[3, :3], over.own[20, vertex] * mirrored, atol=1e-3)
        along = matrix[1, :3] / np.linalg.norm(matrix[1, :3])
        np.testing.assert_allclose(along, force / np.linalg.norm(force), atol=1e-3)
        length = scale * np.linalg.norm(force)
        assert np.linalg.norm(matrix[1, :3]) == pytest.approx(length - min(head, 0.6 * length), rel=1e-2)


def test_the_time_line_has_the_keys(page):
    marks = page.locator("#track .due-mark")
    assert [each.get_attribute("title") for each in marks.all()] == ["Key at 0.2 s", "Key at 0.48 s"]
    page.evaluate("document.activeElement.blur(); clothfit.player.goToFrame(0)")
    reached = []
    for key in "nnp":
        page.keyboard.press(key)
        reached.append(int(page.locator("#scrub").input_value()))
    assert reached == [10, STEPS, 10]
    assert "key · distance" in page.locator("#readout").inner_text()
    marks.last.click()
    assert page.locator("#scrub").input_value() == str(STEPS)
    track, mark = (page.locator(each).bounding_box() for each in ("#scrub", "#track .due-mark >> nth=0"))
    middle = (mark["x"] + mark["width"] / 2 - track["x"] - 8) / (track["width"] - 16)
    assert middle == pytest.approx(10 / STEPS, abs=0.01)
