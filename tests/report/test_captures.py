"""What a page says of a capture: residuals of markers with gaps and weights, mistaken ones by name, clock and place."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.scenes import even

from clothfit import load, report_page, simulate
from clothfit.registration.record import Jump, Markers, Registration, Swap
from clothfit.report import captures
from clothfit.report.showing import view

pytestmark = pytest.mark.slow  # compiles a simulation


@pytest.fixture(scope="module")
def seen():
    """A scene, its motion 1 cm off in vertex 5 and 2 cm in frame 3 of vertex 7, as six markers with a gap show it."""
    scene = load(even("nG"))
    motion = simulate(scene)
    x, observed = motion.positions.copy(), np.zeros(motion.positions.shape[:2], bool)
    observed[:, [4, 5, 6, 7, 8, 9]] = True
    observed[2:5, 6] = False
    x[:, 5, 0] += 0.01
    x[3, 7, 1] += 0.02
    weights = np.ones(observed.shape)
    weights[:, 8] = 0.5
    x[~observed] = np.nan
    return scene, replace(motion, positions=x, observed=observed, weights=weights)


def test_every_marker_has_a_row_with_what_is_left_and_what_is_seen(seen):
    scene, target = seen
    show = view(scene, scene, target)
    count = scene.vertex_counts
    marked = Markers((Swap((8, 9)),), (4,), (Jump(7, (3,)),)).summary(count)
    rows = {row[0]: row[1:] for row in captures.table_rows(show, {"markers": [marked]})}
    assert rows["5"][1][1] == pytest.approx(0.01, rel=1e-4)  # the page solves as its scene says
    assert rows["7"][2][1] == pytest.approx(0.02, rel=1e-4)
    assert rows["7"][3][1] == pytest.approx(target.times[3])
    assert rows["6"][4][1] == pytest.approx(1 - 3 / len(target.times))
    assert [rows[i][0] for i in "8947"] == [
        "swapped, was given to 9", "swapped, was given to 8", "false, left out", "jumped, 1 frame left out",
    ]  # fmt: skip
    assert set(list(rows)[:4]) == set("8947")
    assert rows["8"][5][1] == 0.5
    page = report_page(scene, scene, target).decode()
    assert '"markers":[4,5,6,7,8,9]' in page
    assert "clothfit/captures" in page
    show = view(scene, scene, simulate(scene))  # which is seen whole and has no markers
    assert captures.table_rows(show, {}) == []
    assert captures.content(show, {})["markers"] == []


def test_clock_and_place_stand_with_their_intervals():
    known = Registration(1.0, 0.015, translation=np.array([0.01, 0.0, 0.0]), within=np.full(9, 2e-4))
    rows = dict(captures.registered({"registration": [known.summary()]}))
    assert rows["target's clock at the start"] == "0.01500 ± 0.00020 s"
    assert rows["target moved by"] == "(0.01000, 0.00000, 0.00000) ± (0.00020, 0.00020, 0.00020) m"
    assert "target turned by" not in rows
    plain = dict(captures.registered({"registration": [Registration(1.1, 0.0).summary()]}))
    assert plain == {"target's clock, rate": "1.1"}


@pytest.mark.parametrize("wrong", [[], {}, 3, "x", [1], [{"offset": "a"}], [{"intervals": [1], "offset": 1e400}]])
def test_summaries_are_not_trusted(seen, wrong):
    scene, target = seen
    show = view(scene, scene, target)
    assert captures.registered({"registration": wrong}) == []
    damaged = [{"swapped": wrong, "false": [{"object": 7, "vertex": 1}], "jumps": [{"object": 0, "vertex": 10**9}]}]
    assert captures.remarks(show, {"markers": damaged}) == {}
    assert captures.remarks(show, {"markers": wrong}) == {}
