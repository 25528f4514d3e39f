"""`clothfit report` and `estimate --report`: what a page holds, how it is packed, what is read of a log."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from helpers.scenes import cloth, document, even, sphere, trial, write_scene
from helpers.unpacking import content_of, unpacked, unpacked_positions

from clothfit import InvalidInput, degrade, load, report_page, simulate
from clothfit.cli.program import run
from clothfit.evaluation.evaluate import evaluate, per_frame
from clothfit.motion.motion import as_motion, save_motion
from clothfit.report.log import Log, intervals, read_log
from clothfit.report.packing import box, packed, packed_errors, packed_flags, packed_positions
from clothfit.report.page import WEB, page
from clothfit.report.showing import default_length, view

pytestmark = pytest.mark.slow  # compiles a fit


def table_of(content, name):
    """A table of a page."""
    (found,) = (each for each in content["tables"] if each["id"] == name)
    return found


def text_of(cell):
    """What a cell shows."""
    return cell[0] if isinstance(cell, list) else cell


def row_of(content, name, first):
    """The row of a table that begins with a text, by the heads of its columns."""
    table = table_of(content, name)
    (row,) = (row for row in table["rows"] if text_of(row[0]) == first)
    return dict(zip(table["heads"], map(text_of, row), strict=True))


def waving(frames, vertices, seed=0):
    """Positions of vertices that swing, each at its own pace."""
    rng = np.random.default_rng(seed)
    phase, pace = rng.uniform(0, 6, (2, vertices, 3))
    return np.sin(0.1 * np.arange(frames)[:, None, None] * pace + phase) * [3.0, 0.1, 1e-6] + [0.0, -50.0, 7.0]


# --- packing


def test_positions_come_back_within_half_a_step_of_the_grid_and_what_was_not_seen_stays_where_it_was():
    x = waving(40, 30)
    x[2:4, 1] = np.nan
    low, step = box(x)
    back = unpacked_positions(packed_positions(x, low, step))
    gap = np.nanmax(np.abs(back - x), axis=(0, 1))
    assert (gap <= 0.5 * step * (1 + 1e-6) + 1e-14).all()  # rounding of q, and of the sum at 50 m
    assert step[0] == pytest.approx(6.0 / 65535, rel=1e-2)  # the finest of 16 bits
    assert (back[2:4, 1] == back[1, 1]).all()
    large = waving(100, 2000)  # a fifteenth of 5,000 × 300 of two motions
    assert len(packed_positions(large, *box(large))["data"]) * 15 < 25e6


def test_any_whole_numbers_of_16_bits_come_back_and_a_motion_without_a_box():
    x = np.random.default_rng(1).integers(0, 65536, (20, 7, 3)).astype(float)
    x[0, 0], x[0, 1] = 0.0, 65535.0
    for motion in (x, np.full((3, 2, 3), 4.5)):
        assert np.array_equal(unpacked_positions(packed_positions(motion, *box(motion))), motion)


def test_arrays_errors_and_flags_come_back():
    for array in (np.linspace(0, 1, 7), np.arange(6).reshape(2, 3), np.array([True, False])):
        back = unpacked(packed(array))
        assert back.shape == array.shape
        assert np.allclose(back, array, rtol=1e-7)  # float32
    record = packed_errors(np.array([[0.0, 4.0, np.nan, 1e-4]]))
    assert record["most"] == 4.0
    assert unpacked({**record, "type": "uint8"}).tolist() == [[0, 255, 0, 1]]  # 255 √(1e-4 / 4) = 1.3
    assert packed_errors(np.zeros((2, 2)))["most"] == 0.0
    record = packed_flags(np.array([[True, False, False], [True, True, False]]))
    assert unpacked({**record, "type": "uint8", "shape": [1]}).tolist() == [0b11001]


# --- what is shown


@pytest.fixture(scope="module")
def both():
    return load(even("LG", 12)), load(even("LG", 12, springStiffness=[33.0] * 33))


def test_the_figures_are_those_of_evaluate(both):
    show, told = view(*both, frames=30), evaluate(*both, horizon=30)
    assert show.evaluation == told
    assert show.rmse[:12] @ show.rmse[:12] == pytest.approx(12 * told.fitted.rmse**2, rel=1e-9)  # mean over frames
    assert show.largest.max() == pytest.approx(told.horizon.max_error, rel=1e-12)
    assert (len(show.times), show.fitted_until) == (30, pytest.approx(0.02 * 11))


def test_a_target_gives_the_times_and_its_gaps(both):
    target = degrade(simulate(both[0]), observed=0.5, every=3)
    show = view(*both, target)
    assert show.times.tolist() == target.times.tolist()
    assert np.array_equal(np.isnan(show.error), ~target.observed)
    assert show.evaluation == evaluate(*both, target=target)


def test_frames_between_steps_lie_on_the_straight_line_and_finer_steps_at_those_of_the_true_scene(both):
    x = simulate(both[1], 5, 1e-10).positions
    target = as_motion(both[0], x[:2], times=np.array([0.01, 0.05]))
    assert np.allclose(view(*both, target).fitted[1], (x[2] + x[3]) / 2, rtol=0, atol=1e-12)
    fine = both[1].with_step(both[1].delta / 2, 23)
    show = view(both[0], fine, frames=15)
    assert np.allclose(show.fitted, simulate(fine, 29, 1e-10).positions[::2], atol=1e-12)  # the same steps
    assert (show.evaluation.fitted.frames, show.evaluation.horizon.frames) == (12, 15)
    assert show.evaluation == evaluate(both[0], fine, horizon=15)


def test_too_many_frames_are_thinned_and_the_curves_are_not_and_the_horizon_is_shorter(both):
    show = view(*both, frames=30, most=2 * 16 * 12)
    assert (len(show.times), len(show.rmse)) == (10, 30)
    assert "one frame in 3 is shown" in show.notes[0]
    assert default_length(both[0], 10**9) == 500
    show = view(*both, most=2 * 16 * 40)
    assert len(show.times) == 40
    assert "ends after 40 frames" in show.notes[0]


def test_a_motion_that_diverges_is_shown_until_it_leaves(both):
    wild = replace(both[1], method=0)
    wild = wild.with_values([c.mass for c in wild.cloths], [np.full(33, 5e3)])
    show = view(both[0], wild)
    assert 2 <= len(show.times) < 200
    assert "diverged" in show.notes[0]
    assert np.isfinite(show.fitted).all()
    assert show.evaluation.diverged


def test_the_curves_leave_out_what_nobody_saw():
    rmse, largest = per_frame(np.array([[9.0, np.nan, 16.0], [np.nan] * 3]))
    assert rmse[0] == pytest.approx(np.sqrt(12.5))
    assert largest[0] == 4.0
    assert np.isnan([rmse[1], largest[1]]).all()


# --- the log

VERDICT = {"model": "adequate", "unexplained": 0.0}
SUMMARY = {"status": "converged", "verdict": VERDICT, "parameters": [
    {"object": 0, "name": "stiffness", "mode": "G", "count": 1, "interval": [[29.0, 31.0]]}
]}  # fmt: skip


def log_file(folder, *lines):
    path = folder / "fit.jsonl"
    path.write_bytes(b"\n".join(line if isinstance(line, bytes) else json.dumps(line).encode() for line in lines))
    return path


def point(evaluations, cost=1.0):
    return {"evaluations": evaluations, "cost": cost, "rmse": 0.1, "seconds": 0.5, "more": [1]}


def test_a_log_is_read(tmp_path):
    log = read_log(log_file(tmp_path, point(1, 4.0), point(2, 2.0), {**point(3), "summary": SUMMARY}))
    assert [one.cost for one in log.points] == [4.0, 2.0, 1.0]
    assert intervals(log.summary, 0, "stiffness", "G", 1) == [[29.0, 31.0]]
    assert log.warnings == []


@pytest.mark.parametrize(
    "line",
    [
        b"{", b"[1, 2]", b"\xff\xfe", b"[" * 100_000, b"nan", b'{"evaluations": 1e999}', b"null",
        json.dumps(point(2, cost=-1.0)).encode(), json.dumps({**point(2), "seconds": "1"}).encode(),
        json.dumps({**point(2), "evaluations": 10**400}).encode(), json.dumps({**point(2), "rmse": None}).encode(),
    ],
)  # fmt: skip
def test_lines_that_say_nothing_are_left_out(tmp_path, line):
    log = read_log(log_file(tmp_path, point(1), line))
    assert len(log.points) == 1
    assert any("ends early" in text for text in log.warnings)


def test_intervals_that_cannot_be_are_none_and_those_without_the_verdict_are_not_read():
    for interval in (None, [[1.0]], [[2.0, 1.0]], [["1", "2"]], [[1.0, 1e999]], "ab", [[1.0, 2.0]] * 2, [None]):
        summary = {**SUMMARY, "parameters": [3, {**SUMMARY["parameters"][0], "interval": interval}]}
        assert intervals(summary, 0, "stiffness", "G", 1) in (None, [None])
    for verdict in (None, "adequate", 1):
        assert intervals({**SUMMARY, "verdict": verdict}, 0, "stiffness", "G", 1) is None


def test_a_long_log_is_thinned_and_keeps_its_end_and_what_is_none_is_refused(tmp_path):
    log = read_log(log_file(tmp_path, *(point(i + 1) for i in range(9000))))
    assert len(log.points) <= 2001
    assert (log.points[0].evaluations, log.points[-1].evaluations) == (1, 9000)
    for content in (b"", b"PK\x03\x04", b"{}\n[]"):
        with pytest.raises(InvalidInput, match="no line of it"):
            read_log(log_file(tmp_path, content))


# --- the page


def test_a_page_stands_alone_with_every_module_and_tells_all(both):
    target = degrade(simulate(both[0]), noise=0.001)
    masses = {"object": 0, "name": "mass", "mode": "L", "interval": [[0.1, 0.3]] * 16}
    log = Log(summary={**SUMMARY, "parameters": [masses]})
    html = report_page(*both, target, log=log, commands=["clothfit report a 'b c'"], inputs=[("a", "0123")])
    text = html.decode()
    assert not re.search(r"(src|href)=|@import|url\(", text.split('id="content"')[0])
    assert text.count("<script") == 3  # data, imports, start
    content = content_of(html)
    assert content["names"] == {"scene": "scene", "fitted": "scene", "target": "scene"}
    assert content["commands"] == ["clothfit report a 'b c'"]
    assert [block["title"] for block in content["blocks"]] == ["Mass"]  # one value for all is a row of a table
    assert row_of(content, "values", "objects[0] stiffness")["fitted"] == "33"
    assert row_of(content, "values", "objects[0] mass, median of 16")["95 % interval"] == "± 0.1"
    (text,) = re.findall(r'<script type="importmap" nonce="\w+">(.*?)</script>', text)
    names = {f"clothfit/{path.stem}" for path in WEB.glob("*.js")}
    assert set(json.loads(text)["imports"]) == names | {"three"}
    used = {name for path in WEB.glob("*.js") for name in re.findall(r'from "([\w/]+)";', path.read_text("utf-8"))}
    assert used | {"clothfit/main"} == names | {"three"}
    with pytest.raises(ValueError, match="not JSON compliant"):
        page({"title": "t", "x": float("nan")}, [], [])


def test_titles_and_names_cannot_leave_their_place(both):
    hostile = "</script><img src=x onerror=alert(1)>{{imports}}\u2028<!--"
    html = report_page(replace(both[0], title=hostile, name=hostile), replace(both[1], name=hostile)).decode()
    assert "<img" not in html
    assert "<!--" not in html
    assert content_of(html.encode())["title"] == hostile
    assert html.count('type="importmap"') == 1


def test_what_the_modules_take_from_three_is_what_is_kept_of_it():
    kept = json.loads((WEB / "three" / "version.json").read_text("utf-8"))
    found = " ".join(re.findall(r'import \{([^}]*)\} from "three"', "".join(p.read_text() for p in WEB.glob("*.js"))))
    assert sorted({name.strip() for name in found.replace(" ", ",").split(",") if name.strip()}) == kept["names"]
    assert f"three.js {kept['three']}" in (WEB / "three" / "three.module.min.js").read_text("utf-8")[:200]
    assert "MIT License" in (WEB / "three" / "LICENSE").read_text("utf-8")


def test_every_kind_of_scene_has_a_page_and_every_kind_of_parameter_a_card():
    wind = {"x": 1.0, "y": 0.0, "z": 0.0}
    for fields in ({"triangles": []}, {"colliders": [sphere(0.3)]}, {"windVel": wind}, {"vertIsFixed": [False] * 16}):
        scene = load(trial("nG", 4, fit={"windVel": "G"}, **fields))
        assert len(content_of(report_page(scene, scene, frames=5))["motion"]["times"]) == 5
    fits = {"vertVel": "L", "springRestLength": "L", "damping": "G", "dragCoefficient": "G"}
    own = cloth(optimizationSettings="LG", fit=fits, vertVel=[{"x": 3.0, "y": 4.0, "z": 0.0}] * 12)
    scene = load(document(cloth(), own, fit={"gravity": "G"}, optimizationIterations=4))
    content = content_of(report_page(scene, scene, frames=5))
    found = {(block["title"], block["owner"]): unpacked(block["values"]) for block in content["blocks"]}
    assert len(found) == 3
    assert found["Velocity", "objects[1]"].tolist() == [5.0] * 12  # its length
    names = [text_of(row[0]) for row in table_of(content, "values")["rows"]]
    assert len(names) == 6 + 3  # a row for each kind of the object; of gravity one for each component
    assert [row_of(content, "values", f"scene gravity {axis}")["fitted"] for axis in "xyz"] == ["0", "-9.81", "0"]


# --- the commands


@pytest.fixture
def paths(folder):
    """A scene, a stiffer one and a recording, in the folder that the test works in."""
    write_scene(folder, even("nG", 5))
    write_scene(folder, even("nG", 5, springStiffness=[33.0] * 33), "other.json")
    save_motion(simulate(load("scene.json")), "target.npz")
    return folder


def test_the_page_goes_beside_the_fitted_scene(paths, capsys):
    log_file(paths, point(1), {"summary": SUMMARY})
    assert run(["report", "scene.json", "other.json", "--steps", "9", "--log", "fit.jsonl"]) == 0
    out, err = capsys.readouterr()
    assert out == ""
    assert err.splitlines()[-1].endswith("→ other.report.html")
    content = content_of((paths / "other.report.html").read_bytes())
    assert content["commands"] == [
        "clothfit evaluate scene.json other.json",
        "clothfit report scene.json other.json --steps 9 --log fit.jsonl",
    ]
    assert [name for name, _ in content["inputs"]] == ["scene.json", "other.json", "fit.jsonl"]
    assert row_of(content, "values", "objects[0] stiffness")["95 % interval"] == "29 … 31"


def test_json_tells_the_figures(paths, capsys):
    assert run(["report", "scene.json", "other.json", "--target", "target.npz", "-o", "page.html", "--json", "-q"]) == 0
    out, err = capsys.readouterr()
    told = json.loads(out)
    report = evaluate(load("scene.json"), load("other.json"), target=simulate(load("scene.json")))
    assert err == ""
    assert told["rmse"] == pytest.approx(report.fitted.rmse, rel=1e-4)  # the target is solved less tightly
    assert (told["frames"], told["shown"], told["output"]) == (5, 5, "page.html")
    assert told["bytes"] == (paths / "page.html").stat().st_size


def test_a_motion_that_diverges_ends_with_code_4_and_a_page(paths, capsys):
    write_scene(paths, even("nG", 5, integrationMethod=0, springStiffness=[5e3] * 33), "wild.json")
    assert run(["report", "scene.json", "wild.json"]) == 4
    told = capsys.readouterr().err.splitlines()
    assert "→ wild.report.html" in told[-2]
    assert told[-1].startswith("error: wild.json: the simulation diverged at step")
    assert len([line for line in told if "diverged at step" in line]) == 1
    assert "diverged" in content_of((paths / "wild.report.html").read_bytes())["notes"][0]


def test_a_fit_makes_its_page(paths, capsys):
    fit = ["estimate", "scene.json", "--target", "target.npz", "--start", "9", "--method", "l-bfgs-b"]
    assert run([*fit, "--report", "{stem}.html", "-o", "my fit.json"]) == 0
    assert "→ scene.html" in capsys.readouterr().err
    content = content_of((paths / "scene.html").read_bytes())
    assert content["names"] == {"scene": "scene.json", "fitted": "my fit.json", "target": "target.npz"}
    assert len(content["history"]) > 3
    assert content["history"][0][1] > 100 * content["history"][-1][1]
    assert content["commands"][1] == "clothfit evaluate scene.json 'my fit.json' --target target.npz"
    assert "'{stem}.html'" in content["commands"][0]
    row = row_of(content, "values", "objects[0] stiffness")
    low, high = map(float, row["95 % interval"].split(" … "))
    assert row["start"] == "9"
    assert float(row["fitted"]) == pytest.approx(30.0, rel=1e-3)  # L-BFGS-B stops early
    assert low <= 30.0 * (1 + 1e-5)  # five digits are shown
    assert high >= 30.0 * (1 - 1e-5)
    assert [each["name"] for each in content["beside"]] == ["before the fit"]
    assert "before the fit" in content["headline"]["text"]
    assert content["cost_unit"] == "m²"


def test_the_page_is_not_written_over_an_input_nor_where_the_scene_may_go(paths, capsys):
    assert run(["estimate", "scene.json", "-o", "-", "--report", "-"]) == 3
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    assert err.startswith("error: --report must be a file of its own, not -")
    for taken in ("scene.json", "target.npz", "fitted.json"):
        assert run(["estimate", "scene.json", "--target", "target.npz", "-o", "fitted.json", "--report", taken]) == 3
        assert f"cannot write {taken}: it is an input" in capsys.readouterr().err
    assert not (paths / "fitted.json").exists()
    assert run(["report", "scene.json", "other.json", "-o", "other.json"]) == 3
