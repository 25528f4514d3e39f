"""Point caches, PC2 and MDD: their bytes by hand, round trips to float32, headers that lie."""

import struct

import numpy as np
import pytest
from helpers import files

from clothfit.base.errors import InvalidMotion
from clothfit.formats.animation import Animation
from clothfit.formats.axes import RIGHT

POINTS = np.arange(12.0).reshape(2, 2, 3)  # whole numbers, exact in float32
TIMES = np.array([0.0, 0.25])
PC2 = struct.pack("<12siiffi12f", b"POINTCACHE2\0", 1, 2, 0, 1, 2, *POINTS.ravel())
MDD = struct.pack(">ii2f12f", 2, 2, *TIMES, *POINTS.ravel())
BYTES = {"pc2": PC2, "mdd": MDD}
EACH = pytest.mark.parametrize("suffix", BYTES)


def encoded(suffix, animation):
    return files.written(f"a.{suffix}", animation)


@pytest.fixture
def read(tmp_path):
    return lambda suffix, data: files.read(tmp_path, f"a.{suffix}", data)


@EACH
def test_the_bytes_are_those_of_the_format_and_are_read(read, suffix):
    assert encoded(suffix, Animation(POINTS, RIGHT, TIMES)) == BYTES[suffix]
    found = read(suffix, BYTES[suffix])
    np.testing.assert_array_equal(found.positions, POINTS)
    assert (found.axes, found.triangles, found.notes, found.spacing) == (RIGHT, None, (), 1)
    assert (None if found.times is None else found.times.tolist()) == {"pc2": None, "mdd": [0, 0.25]}[suffix]


def test_samples_that_are_no_frame_apart_are_told_and_times_that_are_all_0_are_none(read):
    found = read("pc2", PC2.replace(struct.pack("<f", 1.0), struct.pack("<f", 0.5), 1))
    assert (found.spacing, found.notes) == (0.5, ("its samples are 0.5 frames apart",))
    still = MDD.replace(struct.pack(">f", 0.25), struct.pack(">f", 0))
    assert read("mdd", still).times is None
    assert encoded("mdd", Animation(POINTS, RIGHT)) == still


@EACH
@pytest.mark.parametrize("numbers", [(0, 2), (2, 0), (-1, 2), (2, -1), (2, 3), (2**31 - 1, 2**31 - 1), (-(2**31), -1)])
def test_a_header_that_lies_is_refused_before_memory_is_taken(read, suffix, numbers):
    frames, points = numbers
    lying = {"pc2": PC2[:16] + struct.pack("<iffi", points, 0, 1, frames) + PC2[32:],
             "mdd": struct.pack(">ii", frames, points) + MDD[8:]}  # fmt: skip
    with pytest.raises(InvalidMotion, match=r"frames of .* points"):
        read(suffix, lying[suffix])


@EACH
def test_a_position_that_is_infinite_is_refused_and_one_that_is_no_number_was_not_seen(read, suffix):
    points = POINTS.copy()
    points[1, 0, 2] = np.inf
    with pytest.raises(InvalidMotion, match="frame 1, point 0: its position is infinite"):
        read(suffix, encoded(suffix, Animation(points, RIGHT)))
    points[1, 0, 2] = np.nan
    assert np.array_equal(np.isnan(read(suffix, encoded(suffix, Animation(points, RIGHT))).positions), np.isnan(points))


@EACH
def test_a_file_of_another_length_is_refused(read, suffix):
    whole = BYTES[suffix]
    for size in range(len(whole)):
        with pytest.raises(InvalidMotion, match=f"a.{suffix}: "):
            read(suffix, whole[:size])
    with pytest.raises(InvalidMotion, match="2 frames of 2 points take"):
        read(suffix, whole + b"\0")


@pytest.mark.parametrize(
    ("suffix", "data", "message"),
    [
        ("pc2", PC2[:12] + struct.pack("<i", 2) + PC2[16:], "is of version 2 of PC2, 1 can be read"),
        ("pc2", MDD, "does not begin as a PC2 point cache does"),
        *[("mdd", MDD[:8] + struct.pack(">2f", *times) + MDD[16:], "its times are not finite and increasing")
          for times in [(0.25, 0), (1, 1), (np.nan, 1), (0, np.inf)]],
    ],
)  # fmt: skip
def test_other_versions_other_files_and_other_times_are_refused(read, suffix, data, message):
    with pytest.raises(InvalidMotion, match=message):
        read(suffix, data)
