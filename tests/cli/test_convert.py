"""`clothfit convert`, and motions of other programs in the other commands."""

import struct
import sys
from io import BytesIO
from types import SimpleNamespace

import numpy as np
import pytest
from helpers.scenes import trial, write_scene

from clothfit import InvalidMotion, Reading, load, load_motion, save_motion, simulate
from clothfit.cli import convert
from clothfit.cli.common.console import Console
from clothfit.cli.parts.estimate_files import Files
from clothfit.cli.parts.estimate_many import planned
from clothfit.cli.program import gathered
from clothfit.formats import obj
from clothfit.many.estimate_many import packed_targets

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("folder")]  # with a scene; compiles a fit

TRIANGLES = [[0, 1, 2], [2, 1, 3]]


def points(frames=4):
    return np.random.default_rng(0).normal(size=(frames, 4, 3))


# --- convert


@pytest.mark.parametrize("out", ["b.trc", "b.csv", "b.c3d", "b.pc2", "b.mdd", "b.glb"])
def test_a_unit_without_a_name_is_not_taken_for_rounding(said, summary, out):
    np.savez("a.npz", positions=points(), times=0.1 * np.arange(4))
    code, _, err = said(f"convert a.npz {out} --to-scale 0.3")
    assert code == 0
    metres = "a unit of 0.3 m; it is written in metres" in err
    assert metres == (out in ("b.trc", "b.csv", "b.c3d"))
    back = summary(f"convert {out} c.npz --fps 10" + ("" if metres else " --scale 0.3"))
    assert back["frames"] == 4
    with np.load("c.npz") as found:
        np.testing.assert_allclose(found["positions"], points(), rtol=0, atol=1e-6)  # float32 of numbers of 3
    written = summary(f"convert a.npz {out} --to-scale 0.3")["written"]
    assert written["scale"] == (1.0 if metres else 0.3)
    assert written["largest_rounding"] < 1e-6


def test_from_npz_through_all_formats_and_back(said, folder):
    """With faces: of the input, and kept in .npz."""
    np.savez("a.npz", positions=points(), times=0.1 * np.arange(4), triangles=np.array(TRIANGLES))
    assert said("convert a.npz 'b_*.obj' --to-up z --to-scale 0.01")[0] == 0
    assert len(list(folder.glob("b_*.obj"))) == 4
    assert said("convert 'b_*.obj' c.npz --up z --scale 0.01 --fps 10")[0] == 0
    found = np.load("c.npz")
    np.testing.assert_allclose(found["positions"], points(), rtol=4e-16)  # two roundings by the unit
    np.testing.assert_allclose(found["times"], 0.1 * np.arange(4))
    assert found["triangles"].tolist() == TRIANGLES
    assert said("convert c.npz d.pc2")[0] == said("convert d.pc2 e.mdd --fps 10")[0] == 0
    assert said("convert e.mdd f.npz")[0] == 0
    # half of the last of float32's 24 bits, of numbers below 4
    np.testing.assert_allclose(np.load("f.npz")["positions"], points(), rtol=0, atol=4 * 2.0**-24)


def test_the_summary_tells_of_both_files(summary, folder):
    np.savez("a.npz", positions=points())
    own = summary("convert a.npz b.mdd --handedness right --fps 90 --to-up z --frames 1:")
    assert (own["frames"], own["points"], own["output"]) == (3, 4, "b.mdd")
    assert own["seconds"] == pytest.approx(2 / 90)
    (read,) = own["reading"]
    assert [read[name] for name in ("file", "format", "up", "handedness", "scale")] == ["a.npz", "npz", "y", "right", 1]
    written = own["written"]
    assert [written[name] for name in ("up", "handedness", "scale", "faces")] == ["z", "right", 1, 0]
    assert 0 < written["largest_rounding"] <= 4 * 2.0**-24
    back = np.frombuffer((folder / "b.mdd").read_bytes()[20:], ">f4").reshape(3, 4, 3)
    x, y, z = np.moveaxis(points()[1:], -1, 0)
    np.testing.assert_array_equal(back, np.stack([x, -z, y], -1).astype(np.float32))


def test_what_the_shell_makes_of_a_sequence_is_a_sequence(said, summary, folder):
    np.savez("a.npz", positions=points())
    said("convert a.npz 'b2_*.obj'")
    names = [f"b2_{i:04d}.obj" for i in range(4)]
    assert summary(f"convert {' '.join(names)} c.pc2")["frames"] == 4
    whole = [*names, "x", str(folder / "b2_0000.obj")]
    assert gathered(["--target", *whole]) == ["--target", "b2_*.obj", *whole[4:]]
    assert gathered(names[:3]) == names[:3]  # not all of them
    assert gathered([*names, "z.obj"]) == [*names, "z.obj"]
    assert gathered([]) == []


def test_a_file_without_times_gives_an_npz_without(said, folder):
    np.savez("a.npz", positions=points())
    said("convert a.npz b.pc2")
    _, _, err = said("convert b.pc2 c.npz")
    assert "without times, as IN has none (--fps)" in err
    assert "times" not in np.load("c.npz")
    _, _, err = said("convert b.pc2 c.mdd")
    assert "30 frames a second assumed" in err
    assert struct.unpack(">4f", (folder / "c.mdd").read_bytes()[8:24])[1] == np.float32(1 / 30)


def test_faces_come_from_the_mesh_else_the_scene_else_the_file(summary):
    scene = load("scene.json")
    save_motion(simulate(scene), "a.npz")
    assert summary("convert a.npz b.pc2")["written"]["faces"] == 0
    assert summary("convert a.npz 'b_*.obj' --scene scene.json")["written"]["faces"] == 18
    with open("m.obj", "wb") as file:
        file.write(b"v 0 0 0\n" * 16 + b"f 1 2 3\n")
    assert summary("convert a.npz 'b_*.obj' --scene scene.json --mesh m.obj")["written"]["faces"] == 1
    assert summary("convert 'b_*.obj' 'c_*.obj'")["written"]["faces"] == 1


def test_standard_input_is_an_npz(summary, monkeypatch):
    file = BytesIO()
    np.savez(file, positions=points())
    monkeypatch.setattr(sys, "stdin", SimpleNamespace(buffer=BytesIO(file.getvalue())))
    assert summary("convert - b.pc2 --up z")["points"] == 4


# --- the other commands


def test_what_is_assumed_of_a_cache_is_in_the_summary(said, summary, fits):
    said("target scene.json -o a.npz")
    said("target scene.json -o a.pc2")
    assert "reading" not in summary("estimate scene.json --target a.npz")
    own = summary("estimate scene.json --target a.pc2@scene.json")["reading"][0]
    assert [own[name] for name in ("file", "frames", "up")] == ["a.pc2", 5, "y"]
    (exact,), ((rounded, _),) = (asked.targets for asked in fits)
    # half of the last of float32's 24 bits, of numbers below 4
    np.testing.assert_allclose(rounded.positions, exact.positions, rtol=0, atol=4 * 2.0**-24)
    for line in ("evaluate scene.json scene.json --target a.pc2", "check scene.json --target a.pc2 --steps 3"):
        assert summary(line)["reading"][0]["format"] == "PC2 point cache"


def test_many_scenes_have_their_own_caches(said, folder):
    """Read here, as a fit elsewhere is given no files."""
    for name, frames in (("one", 4), ("two", 5)):
        write_scene(folder, trial("nG", frames), f"{name}.json")
        said(f"simulate {name}.json -o '{name}_*.obj' --up z")
    files = Files(("{stem}_*.obj",), None, "out/", False, None, False, Reading(up="z"))
    items = planned(("one.json", "two.json"), files, 2, True, Console(quiet=True))
    for item, frames in zip(items, (4, 5), strict=True):
        first, second = (item.job(number, 0, {}).targets for number in (0, 1))
        assert len(first[0][0].times) == frames
        assert second == first  # the next start is given the same motion
        assert [each["file"] for each in item.readings] == [f"{item.path[:3]}_*.obj"]
    (goal,) = packed_targets("two_*.obj", "two.json")
    assert (len(goal[0].times), goal[1]) == (5, None)


def test_a_simulation_goes_where_its_suffix_says(said, folder):
    code, _, err = said("simulate scene.json -o 'a_*.obj' --up z --scale 0.01 --energy -q")
    assert (code, err) == (0, "")
    assert len(list(folder.glob("a_*.obj"))) == 5
    _, _, err = said("simulate scene.json -o a.pc2")
    assert "a.pc2: PC2 point cache, y up, right-handed, metres; it has no times: there are 50 frames a second" in err
    said("simulate scene.json")
    expected = load_motion("scene.motion.npz", load("scene.json")).positions
    found = obj.read("a_*.obj").positions
    np.testing.assert_allclose(found, 100 * np.stack([-expected[..., 0], -expected[..., 2], expected[..., 1]], -1))


def test_weights_that_are_lost_are_told(said):
    np.savez("a.npz", positions=points(), weights=np.ones(4))
    assert "warning: b.pc2: has no place for weights; .npz has" in said("convert a.npz b.pc2")[2]


@pytest.mark.parametrize("suffix", [".trc", ".csv", ".c3d"])
def test_a_marker_without_a_name_gets_one_that_can_be_read_again(said, folder, suffix):
    header = ",".join(f"{name}_{axis}" for name in ("v1", "", "a b") for axis in "xyz")
    (folder / "m.csv").write_text(f"time,{header}\n0,{'1,' * 8}1\n0.1,{'2,' * 8}2\n")
    assert said(f"convert m.csv n{suffix}")[0] == 0
    assert said(f"info n{suffix}")[0] == 0


def test_a_file_that_cannot_be_read_again_is_not_kept(said, folder, monkeypatch):
    def fail(*given):
        raise InvalidMotion("y.pc2: is damaged")

    monkeypatch.setattr(convert, "largest_rounding", fail)
    np.savez("a.npz", positions=points(), times=0.1 * np.arange(4))
    for name in ("y.pc2", "z_*.obj"):
        code, _, err = said(f"convert a.npz '{name}'")
        assert (code, list(folder.glob(name))) == (3, [])
        assert "what was written cannot be read again, so it is not kept: y.pc2: is damaged" in err


def test_a_doubt_is_a_warning(said):
    said("simulate scene.json -o a.pc2 --up z")
    _, _, err = said("evaluate scene.json scene.json --target a.pc2")
    warning = next(line for line in err.splitlines() if line.startswith("warning"))
    assert "RMS) away from where the scene begins; --up z would fit" in warning


def test_the_rate_of_a_target_is_its_own(said, summary):
    """`target --fps` is how often it is recorded, in whatever format."""
    own = summary("target scene.json --fps 100 -o a.mdd")
    assert own["frames"] == 9
    _, _, err = said("convert a.mdd b.npz")
    assert "100 frames a second by its own times" in err


def test_a_rate_beyond_single_precision_is_refused(said):
    np.savez("a.npz", positions=points())
    code, _, err = said("convert a.npz b.c3d --fps 1e300")
    error = "error: b.c3d: 1e+300 frames a second do not fit into single precision; use .trc"
    assert (code, err.splitlines()[-1]) == (3, error)
