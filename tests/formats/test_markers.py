"""Files of markers: made by hand and read, written and read by others, damaged."""

import re

import ezc3d
import numpy as np
import pytest
from helpers import files
from helpers import marker_files as made
from helpers.marker_files import TWO, check, motion

from clothfit.base.errors import InvalidMotion
from clothfit.formats import c3d
from clothfit.formats.animation import Animation
from clothfit.formats.axes import RIGHT, Axes

NAN = np.nan
SUFFIXES = ("c3d", "trc", "csv")
MILLI = Axes("z", "right", 0.001)


@pytest.fixture
def read(tmp_path):
    return lambda data, suffix="csv": files.read(tmp_path, f"a.{suffix}", data)


def written(suffix, animation):
    return files.written(f"a.{suffix}", animation)


# TRC and CSV


WIDE = "time,hem_x,hem_y,hem_z,cuff_x,cuff_y,cuff_z\n0,1,2,3,4,5,6\n0.01,1.5,2,3,,nan,\n"
SEMICOLONS = WIDE.replace(",", ";")


@pytest.mark.parametrize(
    ("data", "axes"),
    [
        *[(text, RIGHT) for text in (
            WIDE,
            made.LONG,
            WIDE.replace(",", "\t"),
            SEMICOLONS,
            SEMICOLONS.replace("0.01", "0,01").replace("1.5", "1,5"),
            made.LONG.replace(",", ";").replace(".", ","),
            "\ufeff" + WIDE,
            WIDE.encode("utf-16"),
            WIDE.replace("\n", "\r\n"),
            WIDE.replace("\n", "\r"),
            WIDE.replace("_", "."),
            WIDE.replace("_", ":").replace("x", "X"),
            WIDE.replace("_", "").replace("time", "Time (s)"),
            WIDE.replace("hem_x", '"hem_x"'),
            WIDE.replace("\n", ",,\n"),
            "# a comment\n\n" + WIDE,
            "frame," + WIDE.replace("\n0", "\n7,0", 1).replace("\n0.01", "\n8,0.01"),
            made.LONG.replace("time", "t").replace("marker", "Label"),
        )],
        ("# unit: mm\n# up: z\n# handedness: left\n" + WIDE, Axes("z", "left", 0.001)),
        ("#Units=mm\n#up=Z\n#handedness=left\n" + WIDE, Axes("z", "left", 0.001)),
        (re.sub("_([xyz])", r" \1 (mm)", WIDE), Axes("y", "right", 0.001)),
        (made.MOTIVE, Axes("y", "right", 0.001)),
    ],
)  # fmt: skip
def test_tables_of_many_kinds(read, data, axes):
    found = read(data)
    check(found)
    assert found.axes == axes
    if data == WIDE:
        assert "unit m, up y, handedness right" in found.notes[0]
        assert read(data.replace("hem", "Ärmel").encode("latin-1")).names == ("Ärmel", "cuff")


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_a_trc_file_made_by_hand_with_line_ends_of_any_kind(read, end):
    found = read(made.TRC.replace("\n", end).encode(), "trc")
    check(found)
    assert found.axes == Axes("y", "right", 0.001)


@pytest.mark.parametrize(("head", "times"), [("", None), ("# rate: 50\n", [0, 0.02, 0.04])])
def test_frames_that_are_left_out_are_gaps(read, head, times):
    found = read(head + "frame,hem_x,hem_y,hem_z\n11,1,2,3\n13,4,5,6\n")
    np.testing.assert_array_equal(found.positions[:, 0], [[1, 2, 3], [NAN] * 3, [4, 5, 6]])
    np.testing.assert_array_equal(found.observed, [[True], [False], [True]])
    assert (None if found.times is None else found.times.tolist()) == times
    found = read("time,a_x,a_y,a_z\n0,1,2,3\n1,1,,3\n")  # a marker of which a coordinate is missing is one as well
    np.testing.assert_array_equal(found.observed, [[True], [False]])
    assert np.isnan(found.positions[1]).all()


# Of what is written with all digits the same numbers come back; C3D has float32.
@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("axes", [RIGHT, MILLI, Axes("y", "right", 0.01)])
def test_round_trip_to_the_formats_own_precision(read, suffix, axes):
    own = motion(axes if suffix != "trc" else axes._replace(up="y"), names=("a", "hem, left", "c", "d", "é"))
    found = read(written(suffix, own), suffix)
    expected = own.positions.astype(np.float32) if suffix == "c3d" else own.positions
    np.testing.assert_array_equal(found.positions, expected)
    np.testing.assert_allclose(found.times, own.times, rtol=4e-16 if suffix != "c3d" else 1e-7)  # the rate is float32
    np.testing.assert_array_equal(found.observed, np.isfinite(own.positions).all(axis=2))
    assert found.names == own.names
    assert found.axes == own.axes


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_what_is_hidden_is_not_written_and_a_unit_without_a_name_is_written_in_metres(read, suffix):
    own, hidden = motion(Axes("y", "right", 0.25), gaps=False), np.ones((7, 5), bool)
    hidden[3, 1] = False
    times = own.times if suffix == "c3d" else own.times**1.5  # uneven ones are kept in text
    found = read(written(suffix, Animation(own.positions, own.axes, times, None, hidden)), suffix)
    np.testing.assert_array_equal(found.observed, hidden)
    np.testing.assert_allclose(found.positions[hidden], 0.25 * own.positions[hidden], rtol=1e-7)  # float32
    assert found.axes == RIGHT
    if suffix != "c3d":
        np.testing.assert_array_equal(found.times, times)


@pytest.mark.parametrize("suffix", ["trc", "csv"])
def test_names_cannot_act_on_a_terminal_nor_break_the_table(read, suffix):
    own = motion(names=("\x1b[31mred", "two\nlines", "tab\there", "x" * 500, " b "))
    found = read(written(suffix, own), suffix)
    assert all(name.isprintable() and len(name) <= 60 for name in found.names)
    assert found.names[0] == "?[31mred"
    assert found.positions.shape == own.positions.shape


# A table of a thousand lines for each marker and frame of a square: the square of the lines in positions.
def test_tables_that_fill_the_memory_are_refused_before_it(read, monkeypatch):
    monkeypatch.setattr("clothfit.base.memory.missing", lambda needed: 10**7 if needed > 10**7 else None)
    with pytest.raises(InvalidMotion, match="keep fewer frames"):
        read("frame,marker,x,y,z\n" + "".join(f"{i},m{i},1,2,3\n" for i in range(1000)))


# C3D files: made by hand for three processors, written and read by ezc3d.


# 1.5 and the whole numbers are exact in float32 and, in halves, in integers.
@pytest.mark.parametrize("number", [made.INTEL, made.DEC, made.MIPS])
@pytest.mark.parametrize("scale", [-1.0, 0.5])
def test_a_c3d_file_made_by_hand_for_any_processor(read, number, scale):
    def more(processor):
        return made.texts(processor, 1, "LABELS", "hem", "cuff") + made.texts(processor, 1, "UNITS", "cm")

    found = read(made.c3d(TWO, number, scale, analog=3, more=more), "c3d")
    check(found)
    assert found.axes == Axes("z", "right", 0.01)


# ezc3d does not read MIPS's numbers.
@pytest.mark.parametrize("number", [made.INTEL, made.DEC])
@pytest.mark.parametrize("scale", [-1.0, 0.5])
def test_ezc3d_reads_the_same(read, tmp_path, number, scale):
    found = read(made.c3d(TWO, number, scale, more=lambda processor: made.facts(processor, 2, 2, scale)), "c3d")
    other = ezc3d.c3d(str(tmp_path / "a.c3d"))["data"]["points"][:3].transpose(2, 1, 0)
    np.testing.assert_array_equal(other, found.positions)


def test_the_axis_that_is_up_on_the_screen_and_what_a_c3d_file_does_not_tell(read):
    for screen, up in (("+Y", "y"), ("+Z", "z"), ("-X", "z")):
        data = made.c3d(TWO, more=lambda processor, screen=screen: made.texts(processor, 1, "Y_SCREEN", screen))
        assert read(data, "c3d").axes.up == up
    found = read(made.c3d(TWO), "c3d")
    assert (found.axes, found.names, len(found.notes)) == (MILLI, ("marker 1", "marker 2"), 2)


def test_angles_and_forces_are_no_markers(read):
    def more(processor):
        return made.texts(processor, 1, "LABELS", "knee", "hem") + made.texts(processor, 1, "ANGLES", "knee")

    found = read(made.c3d(TWO[:1], more=more), "c3d")
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
    (tmp_path / "a.c3d").write_bytes(written("c3d", own))
    found = ezc3d.c3d(str(tmp_path / "a.c3d"))
    facts = found["parameters"]["POINT"]
    np.testing.assert_array_equal(found["data"]["points"][:3].transpose(2, 1, 0), own.positions.astype(np.float32))
    assert facts["RATE"]["value"][0] == 90
    assert facts["UNITS"]["value"] == ["m" if axes == RIGHT else "mm"]
    assert facts["Y_SCREEN"]["value"] == [f"+{axes.up.upper()}"]
    assert [*facts["LABELS"]["value"], *facts["LABELS2"]["value"]] == list(own.names)


def test_more_frames_than_16_bits_can_tell(read):
    own = motion(frames=70_000, points=1, gaps=False)
    found = read(written("c3d", own), "c3d")
    np.testing.assert_array_equal(found.positions, own.positions.astype(np.float32))


def test_of_a_file_that_ends_early_the_whole_frames_are_read(read):
    every = np.arange(27.0).reshape(9, 1, 3)
    found = read(made.c3d(every)[:-20], "c3d")  # of 16 bytes a frame: two are lost
    np.testing.assert_array_equal(found.positions, every[:7])
    assert "it ends early: 9 frames are promised, 7 are there" in found.notes


# CSV files of Vicon Nexus: other sections, velocities, gaps, damage. One of Nexus itself: test_other_programs.


DEVICES = "Devices\n1000\n,,plate - Force,,\nFrame,Sub Frame,Fx,Fy,Fz\n,,N,N,N\n7,0,1,2,3\n7,1,1,2,3\n\n"
TRAJECTORIES = (
    "Trajectories,,,,,,,,,,,,,,\n200\n,,Anna:hem,,,,,,Anna:cuff,,,*7,,\n"
    "Frame,Sub Frame,X,Y,Z,X',Y',Z',X,Y,Z,X,Y,Z\n,,m,m,m,m/s,m/s,m/s,m,m,m,m,m,m\n"
    "7,0,1,2,3,9,9,9,4,5,6,,,\n9,0,1.5,2,3,9,9,9,,,,7,8,9\n\n"
)


@pytest.mark.parametrize("before", ["", DEVICES])
@pytest.mark.parametrize("after", ["", DEVICES])
def test_positions_of_the_trajectories_are_read_with_their_rate_and_gaps(read, before, after):
    found = read(before + TRAJECTORIES + after)
    assert found.names == ("Anna:hem", "Anna:cuff", "*7")
    assert found.axes == Axes("z", "right", 1.0)
    np.testing.assert_array_equal(found.times, [0, 2 / 200])
    np.testing.assert_array_equal(found.observed, [[True, True, False], [True, False, True]])
    np.testing.assert_array_equal(found.positions[:, 0], [[1, 2, 3], [1.5, 2, 3]])
    np.testing.assert_array_equal(found.positions[1, 2], [7, 8, 9])
    semicolons = read(TRAJECTORIES.replace(",", ";").replace("1.5", "1,5"))  # and decimal commas
    np.testing.assert_array_equal(semicolons.positions, found.positions)


POINT = "time,hem_x,hem_y,hem_z\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (POINT + "0,1,2,1_0\n", 'line 2: "1_0" is not a number'),
        (POINT + "0,1,2,x\n", 'line 2: "x" is not a number'),
        ("# rate: 5\n\n" + POINT + "0,1,2,3\n1,1,inf,3\n", 'line 5: "inf" is not a number'),
        (POINT + "0,1,2,3,4\n", "line 2: it has 5 cells, 4 are named"),
        ("# unit: ell\n" + POINT + "0,1,2,3\n", 'unit: "ell" is not one of m, cm, mm, in, ft'),
        ("a" * 200_000 + ",b\n", "it is not a table of cells"),
        ("time,hem_x,hem_y,hem_z,hem_Y\n0,1,2,3,4\n", 'column 5, "hem_Y", is there twice'),
        ("time,marker,x,y,z\n0,a,1,2,3\n1,a,1,2,3\n0,a,1,2,3\n", 'line 4: "a" is there twice'),
        ("frame,a_x,a_y,a_z\n1,1,2,3\n99999999999,1,2,3\n", "frame numbers must be whole and increasing, by less than"),
        (DEVICES, "it has no Trajectories, only Devices; export the trajectories from Nexus"),
        (TRAJECTORIES.replace("200", "fast"), 'line 2: "fast" is not a number'),
        (TRAJECTORIES.replace("200", "0"), "line 2: the rate must be above 0; 0 was given"),
        (DEVICES + TRAJECTORIES.replace("1.5", "l.5"), 'line 15: "l.5" is not a number'),
        (TRAJECTORIES.replace("9,0,1.5", ",0,1.5"), 'line 7: "" is no frame number'),
        ("Trajectories\n", "line 2: the rate must be above 0; nan was given"),
        ("Trajectories\n100\n\nFrame,Sub Frame\n\n", "there are no markers in it"),
    ],
)
def test_what_is_wrong_is_named_with_its_place(read, text, message):
    with pytest.raises(InvalidMotion, match=re.escape(f"a.csv: {message}")):
        read(text)
