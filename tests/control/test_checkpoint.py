"""Searches that go on after they were ended: they come to the same, and take no other search's file."""

import numpy as np
import pytest

from clothfit import Controls, Handle, InvalidInput, Key, find_controls
from clothfit.base import checkpoint
from clothfit.base.checkpoint import Checkpoint, decoded, encoded
from clothfit.control.following import Search, packed, unpacked

pytestmark = pytest.mark.slow  # compiles motions with inputs


@pytest.fixture(scope="module")
def asked(flag):
    """A cloth and keys for it."""
    own = flag()
    x, every = own.cloths[0].positions, np.arange(12, dtype=np.int32)
    free = every[~own.cloths[0].fixed]
    keys = [Key(6, 0, free, x[free] + [0, 0.1, 0.05]), Key(12, 0, free[2:4], x[free[2:4]].mean(axis=0)[None],
                                                            share=np.full(2, 0.5))]  # fmt: skip
    return own, keys


@pytest.fixture(scope="module", params=["forces", "handles"])
def search(request, asked):
    """The controls that are free, and the search that nothing ends."""
    handles = Controls(handles=(Handle(0, np.array([11], np.int32)),), velocity=True)
    controls = Controls() if request.param == "forces" else handles
    return controls, find_controls(*asked, controls)


class Cut:
    """Ends a search, as Ctrl-C does, at an evaluation."""

    def __init__(self, at):
        self.at, self.seen = at, 0

    def __call__(self, effort, missed, evaluations):
        self.seen += 1
        if self.seen == self.at:
            raise KeyboardInterrupt


def test_a_search_goes_on(tmp_path, asked, search):
    controls, whole = search
    file = Checkpoint(tmp_path / "state")
    cut = find_controls(*asked, controls, report=Cut(4 if controls.handles else 30), checkpoint=file)
    assert cut.status == "interrupted"
    assert file.written
    again = find_controls(*asked, controls, checkpoint=Checkpoint(tmp_path / "state", resume=True))
    assert again.status in ("converged", "stalled")
    miss, other = (np.array([key.rmse for key in each.keys]) for each in (again, whole))
    np.testing.assert_allclose(miss, other, atol=2e-3)  # there may be other minima near
    if not controls.handles:
        assert again.effort < 1.02 * whole.effort  # both end where little more is gained


class Killed(BaseException):
    """What nothing catches, as SIGKILL."""


def test_a_search_that_was_killed_ends_where_it_would_have_ended(tmp_path, asked, search, monkeypatch):
    """To the last bit: it goes on from where L-BFGS began anew, or after the last of its searches that was over."""
    monkeypatch.setattr(checkpoint, "EVERY", 0.0)
    monkeypatch.setattr(checkpoint, "WRITING_SHARE", 0.0)
    controls, whole = search
    seen = iter(range(int((0.3 if controls.handles else 0.8) * whole.evaluations)))

    def kill(effort, missed, evaluations):
        if next(seen, None) is None:
            raise Killed

    with pytest.raises(Killed):
        find_controls(*asked, controls, report=kill, checkpoint=Checkpoint(tmp_path / "state"))
    again = find_controls(*asked, controls, checkpoint=Checkpoint(tmp_path / "state", resume=True))
    np.testing.assert_array_equal(again.motion.positions, whole.motion.positions)
    assert (again.evaluations, again.status) == (whole.evaluations, whole.status)


def test_another_search_does_not_go_on(tmp_path, asked):
    own, keys = asked
    file = Checkpoint(tmp_path / "state")
    find_controls(own, keys, Controls(velocity=True), report=Cut(2), checkpoint=file)
    resumed = Checkpoint(tmp_path / "state", resume=True)
    with pytest.raises(InvalidInput, match="belongs to another search: another scene, keys or options"):
        find_controls(own, keys, Controls(wind=True), checkpoint=resumed)
    with pytest.raises(InvalidInput, match="belongs to another search"):
        find_controls(own.with_step(0.01), keys, Controls(velocity=True), checkpoint=resumed)


def test_several_cloths_are_kept():
    rng = np.random.default_rng(0)
    given = {}
    for number, t, n, m in ((2, 4, 5, 0), (0, 3, 2, 6)):
        path, f, left = (rng.normal(size=size) for size in ((t + 1, n, 3), (t, n, 3), m))
        given[number] = Search(path, f, 20.0, "stalled" if m else "", left, 0.5, 2.0)
    found = unpacked(decoded("search", encoded("search", {}, packed(given)), "x")[1])
    assert list(found) == [2, 0]
    for number, own in given.items():
        for field in Search.__dataclass_fields__:
            np.testing.assert_array_equal(getattr(found[number], field), getattr(own, field))
    assert unpacked({}) == {}
