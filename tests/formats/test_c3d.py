"""C3D files: made by hand for three processors, written and read by ezc3d."""

import ezc3d
import numpy as np
import pytest
from helpers import marker_files as made
from helpers.marker_files import TWO, check, motion

from clothfit.formats import c3d
from clothfit.formats.axes import RIGHT, Axes

NAN = np.nan
MILLI = Axes("z", "right", 0.001)


@pytest.fixture
def read(tmp_path):
    def reading(data):
        path = tmp_path / "a.c3d"
        path.write_bytes(data)
        return c3d.read(path)

    return reading


def written(animation):
    (data,) = c3d.encoded("a.c3d", animation).values()
    return data


# 1.5 and the whole numbers are exact in float32 and, in halves, in integers.
@pytest.mark.parametrize("number", [made.INTEL, made.DEC, made.MIPS])
@pytest.mark.parametrize("scale", [-1.0, 0.5])
def test_a_c3d_file_made_by_hand_for_any_processor(read, number, scale):
    def more(processor):
        return made.texts(processor, 1, "LABELS", "hem", "cuff") + made.texts(processor, 1, "UNITS", "cm")

    found = read(made.c3d(TWO, number, scale, analog=3, more=more))
    check(found)
    assert found.axes == Axes("z", "right", 0.01)


# ezc3d does not read MIPS's numbers.
@pytest.mark.parametrize("number", [made.INTEL, made.DEC])
@pytest.mark.parametrize("scale", [-1.0, 0.5])
def test_ezc3d_reads_the_same(read, tmp_path, number, scale):
    found = read(made.c3d(TWO, number, scale, more=lambda processor: made.facts(processor, 2, 2, scale)))
    other = ezc3d.c3d(str(tmp_path / "a.c3d"))["data"]["points"][:3].transpose(2, 1, 0)
    np.testing.assert_array_equal(other, found.positions)


@pytest.mark.parametrize(("screen", "up"), [("+Y", "y"), ("+Z", "z"), ("-X", "z")])
def test_the_axis_that_is_up_on_the_screen(read, screen, up):
    assert read(made.c3d(TWO, more=lambda p: made.texts(p, 1, "Y_SCREEN", screen))).axes.up == up


def test_what_a_c3d_file_does_not_tell_is_told(read):
    found = read(made.c3d(TWO))
    assert found.axes == MILLI
    assert found.names == ("marker 1", "marker 2")
    assert len(found.notes) == 2


def test_angles_and_forces_are_no_markers(read):
    def more(processor):
        return made.texts(processor, 1, "LABELS", "knee", "hem") + made.texts(processor, 1, "ANGLES", "knee")

    found = read(made.c3d(TWO[:1], more=more))
    np.testing.assert_array_equal(found.positions, TWO[:1, 1:])
    assert "angles, forces" in found.notes[0]


def test_a_file_that_ezc3d_writes(tmp_path):
    positions = np.random.default_rng(0).normal(size=(6, 300, 3)).astype(np.float32)
    positions[4, 7] = NAN
    made_ = ezc3d.c3d()
    made_["parameters"]["POINT"]["RATE"]["value"] = [120.0]
    made_["parameters"]["POINT"]["UNITS"]["value"] = ["m"]
    made_["parameters"]["POINT"]["LABELS"]["value"] = [f"m{i}" for i in range(300)]
    made_["data"]["points"] = np.concatenate([positions.transpose(2, 1, 0), np.ones((1, 300, 6))])
    made_.write(str(tmp_path / "a.c3d"))
    found = c3d.read(tmp_path / "a.c3d")
    np.testing.assert_array_equal(found.positions, positions)
    np.testing.assert_allclose(found.times, np.arange(6) / 120)
    assert found.names[0] == "m0"
    assert found.names[299] == "m299"
    assert found.axes.scale == 1


@pytest.mark.parametrize("axes", [RIGHT, MILLI])
def test_ezc3d_finds_what_was_written(tmp_path, axes):
    own = motion(axes, points=300, names=tuple(f"m{i}" for i in range(300)))
    (tmp_path / "a.c3d").write_bytes(written(own))
    found = ezc3d.c3d(str(tmp_path / "a.c3d"))
    facts = found["parameters"]["POINT"]
    np.testing.assert_array_equal(found["data"]["points"][:3].transpose(2, 1, 0), own.positions.astype(np.float32))
    assert facts["RATE"]["value"][0] == 90
    assert facts["UNITS"]["value"] == ["m" if axes == RIGHT else "mm"]
    assert facts["Y_SCREEN"]["value"] == [f"+{axes.up.upper()}"]
    assert [*facts["LABELS"]["value"], *facts["LABELS2"]["value"]] == list(own.names)


def test_more_frames_than_16_bits_can_tell(read):
    own = motion(frames=70_000, points=1, gaps=False)
    found = read(written(own))
    np.testing.assert_array_equal(found.positions, own.positions.astype(np.float32))


def test_of_a_file_that_ends_early_the_whole_frames_are_read(read):
    every = np.arange(27.0).reshape(9, 1, 3)
    found = read(made.c3d(every)[:-20])  # of 16 bytes a frame: two are lost
    np.testing.assert_array_equal(found.positions, every[:7])
    assert "it ends early: 9 frames are promised, 7 are there" in found.notes
