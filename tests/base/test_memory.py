"""Sizes, what is free, and plans for keeping states: what they hold against what they may."""

from pathlib import Path

import pytest

from clothfit.base import memory
from clothfit.base.errors import InvalidInput
from clothfit.base.memory import budget, human, left, parse
from clothfit.engine.tape import LIVE, Plan, least_bytes, plan_for

STATE, SNAPSHOT = 200, 500


SIZES = {"200MB": 2 * 10**8, "2 gib": 2 * 2**30, "1.5G": 1_500_000_000, ".5k": 500, "1e9": 10**9, 12345: 12345}


@pytest.mark.parametrize(("text", "size"), SIZES.items())
def test_sizes(text, size):
    assert parse(text) == budget(text) == size


WORDS = ["", "MB", "200MBit", "-5", "1,5G", "nan", "2 00MB"]
REFUSED = [*((text, f"{text!r} is not a size; give one such as 200MB, 2GiB or 1.5G$") for text in WORDS),
           (0, "must be between 1 byte"), ("1e30", "must be between 1 byte")]


@pytest.mark.parametrize(("text", "said"), REFUSED)
def test_what_is_no_size_or_cannot_be_one_is_refused_with_an_example(text, said):
    with pytest.raises(InvalidInput, match=f"^memory.* {said}"):
        parse(text)


@pytest.mark.parametrize(
    ("size", "text"),
    [(17, "17 bytes"), (999.4, "999 bytes"), (999_900, "1 MB"), (98_300_000, "98.3 MB"), (2.5e12, "2.5e+03 GB")],
)
def test_sizes_for_people(size, text):
    assert human(size) == text


def test_the_default_is_half_of_what_is_free(monkeypatch):
    monkeypatch.setattr(memory, "free", lambda: 1001)
    assert budget(None) == 500


def limit(folder, most, used):
    (folder / "most").write_text(most)
    (folder / "used").write_text(used)
    return folder / "most", folder / "used"


def test_a_container_leaves_what_it_has_not_used(tmp_path, monkeypatch):
    files = limit(tmp_path, "5000000\n", "2000000\n")
    assert left(*files) == 3_000_000
    monkeypatch.setattr(memory, "LIMITS", [files, (Path("/no"), Path("/such"))])
    monkeypatch.setattr(memory, "available", lambda: 10**12)
    assert memory.free() == 3_000_000
    monkeypatch.setattr(memory, "available", lambda: 10**6)
    assert memory.free() == 10**6
    (tmp_path / "memory.stat").write_text("anon 300\nactive_file 200\ninactive_file 400\n")
    assert left(*files) == 3_000_400  # what it keeps of files that it has read is free
    assert left(*limit(tmp_path, "max\n", "10")) is None
    assert left(*limit(tmp_path, "10", "1000")) == 0


def test_what_is_free_is_no_more_than_the_machine_has():
    assert 0 < memory.free() <= memory.physical()


@pytest.mark.parametrize("steps", [1, 2, 7, 99, 1000])
@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.9, 1.0])
def test_a_plan_holds_no_more_than_it_may_and_covers_all_steps(steps, share):
    low, high = least_bytes(steps, STATE, SNAPSHOT), steps * STATE
    most = max(low, low + share * (high - low))
    found = plan_for(steps, STATE, SNAPSHOT, most)
    kept = 0 if found.snapshots is None else (found.snapshots + LIVE) * SNAPSHOT
    assert found.length * STATE + kept <= most
    assert plan_for(steps, STATE, SNAPSHOT, low - 1) is None
    assert found.strides[-1] == found.length
    assert all(a % b == 0 for a, b in zip(found.strides, found.strides[1:], strict=False))
    counts = [-(-a // b) for a, b in zip([max(steps, 1), *found.strides], found.strides, strict=False)]
    assert sum(counts) <= (found.snapshots or 1)


def test_everything_is_kept_where_it_fits_and_as_few_steps_as_possible_are_done_again_where_not():
    assert plan_for(1000, STATE, SNAPSHOT, 1000 * STATE) == Plan(1000, (1000,))
    most = 1000 * STATE - 1
    found = plan_for(1000, STATE, SNAPSHOT, most)
    assert found == Plan(500, (500,), 2)  # one level, the longest parts
    levels = [len(plan_for(1000, STATE, SNAPSHOT, m).strides) for m in range(12_000, 60_000, 4000)]
    assert levels == sorted(levels, reverse=True)
    assert levels[0] > 2 > levels[-1]
