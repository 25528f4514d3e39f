"""Files of markers: made by hand and read, written and read by others, damaged."""

import random
import re

import numpy as np
import pytest
from helpers import marker_files as made
from helpers.marker_files import check, motion

from clothfit.base.errors import InvalidMotion
from clothfit.formats import c3d, marker_table, trc
from clothfit.formats.animation import Animation
from clothfit.formats.axes import RIGHT, Axes

NAN = np.nan
MODULES = {"c3d": c3d, "trc": trc, "csv": marker_table}
MILLI = Axes("z", "right", 0.001)


@pytest.fixture
def read(tmp_path):
    def reading(data, suffix="csv"):
        path = tmp_path / f"a.{suffix}"
        path.write_bytes(data if isinstance(data, bytes) else data.encode())
        return MODULES[suffix].read(path)

    return reading


def written(suffix, animation):
    (data,) = MODULES[suffix].encoded(f"a.{suffix}", animation).values()
    return data


# TRC and CSV


def test_a_trc_file_made_by_hand(read):
    found = read(made.TRC, "trc")
    check(found)
    assert found.axes == Axes("y", "right", 0.001)


@pytest.mark.parametrize("end", ["\r\n", "\r"])
def test_a_trc_file_has_line_ends_of_any_kind(read, end):
    check(read(made.TRC.replace("\n", end).encode(), "trc"))


def test_a_file_of_motive_made_by_hand(read):
    found = read(made.MOTIVE)
    check(found)
    assert found.axes == Axes("y", "right", 0.001)


WIDE = "time,hem_x,hem_y,hem_z,cuff_x,cuff_y,cuff_z\n0,1,2,3,4,5,6\n0.01,1.5,2,3,,nan,\n"
LONG = "time,marker,x,y,z\n0.01,hem,1.5,2,3\n0,hem,1,2,3\n0,cuff,4,5,6\n"


@pytest.mark.parametrize(
    "text",
    [
        WIDE,
        LONG,
        WIDE.replace(",", "\t"),
        WIDE.replace(",", ";"),
        WIDE.replace(",", ";").replace("0.01", "0,01").replace("1.5", "1,5"),
        LONG.replace(",", ";").replace(".", ","),
        "\ufeff" + WIDE,
        WIDE.replace("\n", "\r\n"),
        WIDE.replace("\n", "\r"),
        WIDE.replace("_", "."),
        WIDE.replace("_", ":").replace("x", "X"),
        WIDE.replace("_", "").replace("time", "Time (s)"),
        WIDE.replace("hem_x", '"hem_x"'),
        WIDE.replace("\n", ",,\n"),
        "# a comment\n\n" + WIDE,
        "frame," + WIDE.replace("\n0", "\n7,0", 1).replace("\n0.01", "\n8,0.01"),
        LONG.replace("time", "t").replace("marker", "Label"),
    ],
)
def test_tables_of_many_kinds(read, text):
    check(read(text))


def test_a_table_in_utf_16(read):
    check(read(WIDE.encode("utf-16")))


def test_names_in_an_older_encoding(read):
    assert read(WIDE.replace("hem", "Ärmel").encode("latin-1")).names == ("Ärmel", "cuff")


@pytest.mark.parametrize("head", ["# unit: mm\n# up: z\n# handedness: left\n", "#Units=mm\n#up=Z\n#handedness=left\n"])
def test_comments_tell_axes_and_unit(read, head):
    assert read(head + WIDE).axes == Axes("z", "left", 0.001)


def test_a_unit_in_the_names_of_the_columns(read):
    found = read(re.sub("_([xyz])", r" \1 (mm)", WIDE))
    check(found)
    assert found.axes.scale == 0.001


def test_what_a_table_does_not_tell_is_told(read):
    found = read(WIDE)
    assert found.axes == RIGHT
    assert "unit m, up y, handedness right" in found.notes[0]


@pytest.mark.parametrize(("head", "times"), [("", None), ("# rate: 50\n", [0, 0.02, 0.04])])
def test_frames_that_are_left_out_are_gaps(read, head, times):
    found = read(head + "frame,hem_x,hem_y,hem_z\n11,1,2,3\n13,4,5,6\n")
    np.testing.assert_array_equal(found.positions[:, 0], [[1, 2, 3], [NAN] * 3, [4, 5, 6]])
    np.testing.assert_array_equal(found.observed, [[True], [False], [True]])
    assert (None if found.times is None else found.times.tolist()) == times


def test_a_marker_of_which_a_coordinate_is_missing_is_a_gap(read):
    found = read("time,a_x,a_y,a_z\n0,1,2,3\n1,1,,3\n")
    assert np.isnan(found.positions[1]).all()
    np.testing.assert_array_equal(found.observed, [[True], [False]])


# Of what is written with all digits the same numbers come back; C3D has float32.
@pytest.mark.parametrize("suffix", MODULES)
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


# A unit without a name is turned into metres.
@pytest.mark.parametrize("suffix", MODULES)
def test_a_unit_without_a_name_is_written_in_metres(read, suffix):
    own = motion(Axes("y", "right", 0.25))
    found = read(written(suffix, own), suffix)
    assert found.axes == RIGHT
    np.testing.assert_allclose(found.positions, 0.25 * own.positions, rtol=1e-7)  # float32; a quarter is exact


def test_frames_at_uneven_times_keep_them_in_text(read):
    own = motion()
    uneven = Animation(own.positions, RIGHT, own.times**1.5)
    for suffix in ("trc", "csv"):
        np.testing.assert_array_equal(read(written(suffix, uneven), suffix).times, uneven.times)


@pytest.mark.parametrize("suffix", MODULES)
def test_what_is_hidden_is_not_written(read, suffix):
    own = motion(gaps=False)
    hidden = np.ones((7, 5), bool)
    hidden[3, 1] = False
    found = read(written(suffix, Animation(own.positions, RIGHT, own.times, None, hidden)), suffix)
    np.testing.assert_array_equal(found.observed, hidden)


@pytest.mark.parametrize("suffix", ["trc", "csv"])
def test_names_cannot_act_on_a_terminal_nor_break_the_table(read, suffix):
    own = motion(names=("\x1b[31mred", "two\nlines", "tab\there", "x" * 500, " b "))
    found = read(written(suffix, own), suffix)
    assert all(name.isprintable() and len(name) <= 60 for name in found.names)
    assert found.names[0] == "?[31mred"
    assert found.positions.shape == own.positions.shape


# Damage

LINES = [
    ("time,hem_x,hem_y,hem_z\n0,1,2,1_0\n", "line 2: \"1_0\" is not a number"),
    ("# unit: ell\ntime,hem_x,hem_y,hem_z\n0,1,2,3\n", "unit: \"ell\" is not one of m, cm, mm, in, ft"),
    ("a" * 200_000 + ",b\n", "it is not a table of cells"),
    ("time,hem_x,hem_y,hem_z\n0,1,2,x\n", "line 2: \"x\" is not a number"),
    ("# rate: 5\n\ntime,hem_x,hem_y,hem_z\n0,1,2,3\n1,1,inf,3\n", "line 5: \"inf\" is not a number"),
    ("time,hem_x,hem_y,hem_z\n0,1,2,3,4\n", "line 2: it has 5 cells, 4 are named"),
    ("time,hem_x,hem_y,hem_z,hem_Y\n0,1,2,3,4\n", "column 5, \"hem_Y\", is there twice"),
    ("time,marker,x,y,z\n0,a,1,2,3\n1,a,1,2,3\n0,a,1,2,3\n", "line 4: \"a\" is there twice"),
]


@pytest.mark.parametrize(("text", "message"), LINES)
def test_the_place_is_told(read, text, message):
    with pytest.raises(InvalidMotion, match=re.escape(f"a.csv: {message}")):
        read(text)


def damaged(data, chance):
    kind, place = chance.randrange(4), chance.randrange(len(data))
    changed = bytearray(data)
    if kind == 0:
        return data[:place]
    if kind == 1:
        for _ in range(chance.choice([1, 2, 5])):
            changed[chance.randrange(min(len(data), 1024))] = chance.choice([0, 127, 128, 255, chance.randrange(256)])
    elif kind == 2:
        words = [b"0", b"-1", b"1e308", b"99999999999", b"nan", b'"', b"\n", b"\t", b",", b";", b"\xff", b"#"]
        changed[place : place + chance.choice([0, 1, 3])] = chance.choice(words)
    else:
        other = chance.randrange(len(data))
        changed[place : place + 20] = changed[other : other + chance.randrange(20)]
    return bytes(changed)


@pytest.mark.parametrize("suffix", MODULES)
def test_damaged_files_are_refused_or_read_and_nothing_else(read, suffix):
    chance, good, refused = random.Random(0), written(suffix, motion()), 0
    goods = [good, LONG.encode(), made.MOTIVE.encode()] if suffix == "csv" else [good]
    for i in range(300):
        try:
            found = read(damaged(goods[i % len(goods)], chance), suffix)
            seen = np.isfinite(found.positions).all(axis=2)
            assert (seen if found.observed is None else seen[found.observed]).all()
        except InvalidMotion:
            refused += 1
    assert refused > 60  # so that damage was done


@pytest.mark.parametrize("suffix", MODULES)
@pytest.mark.parametrize("data", [b"", b"\0", b"hello\n", bytes(2000), b"\xff\xfe\x00", b"," * 1000, b"\t\n" * 500])
def test_garbage_is_refused(read, suffix, data):
    with pytest.raises(InvalidMotion, match=r"a\.(c3d|trc|csv): "):
        read(data, suffix)


# A table of a thousand lines for each marker and frame of a square: the square of the lines in positions.
def test_tables_that_fill_the_memory_are_refused_before_it(read, monkeypatch):
    monkeypatch.setattr("clothfit.base.memory.missing", lambda needed: 10**7 if needed > 10**7 else None)
    with pytest.raises(InvalidMotion, match="keep fewer frames"):
        read("frame,marker,x,y,z\n" + "".join(f"{i},m{i},1,2,3\n" for i in range(1000)))


def test_numbers_of_frames_do_not_leap(read):
    with pytest.raises(InvalidMotion, match="by less than"):
        read("frame,a_x,a_y,a_z\n1,1,2,3\n99999999999,1,2,3\n")
