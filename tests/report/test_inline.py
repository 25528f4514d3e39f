"""What notebooks show: frames that play without a network, of scenes, motions and fits."""

import html
import re

import numpy as np
import pytest
from helpers.browsers import differing, opened, pixels
from helpers.fits import estimate
from helpers.scenes import even

from clothfit import Motion, load, simulate

pytestmark = pytest.mark.slow  # compiles a fit, and starts processes


@pytest.fixture(scope="module")
def own():
    return load(even("nF", 12, title="</script><script>alert(1)</script>"))


@pytest.fixture(scope="module")
def motion(own):
    return simulate(own)


def page_of(shown):
    """The page in the frame."""
    return html.unescape(re.search(r'srcdoc="([^"]*)"', shown)[1])


def test_frames_may_run_scripts_and_nothing_else(own, motion):
    fit = estimate(own, motion, time_limit=5.0)
    for thing in (own, motion, fit):
        shown = thing._repr_html_()
        assert 'sandbox="allow-scripts"' in shown
        assert html.escape(repr(thing).strip("<>")) in shown
        page = page_of(shown)
        assert "default-src 'none'" in page
        assert "alert(1)" not in page
        assert not re.search(r"(src|href)=", page)
    bare = Motion(motion.positions, motion.times, motion.vertex_counts)
    assert "srcdoc" in bare._repr_html_()
    lost = Motion(np.full((3, 16, 3), np.nan), np.arange(3.0), (16,))
    assert "srcdoc" not in lost._repr_html_()


def test_a_frame_plays_in_a_browser(started, own, motion, tmp_path):
    for thing in (own, motion, Motion(motion.positions, motion.times, motion.vertex_counts)):
        path = tmp_path / "frame.html"
        path.write_text(page_of(thing._repr_html_()), "utf-8")
        with opened(started, path) as (page, said):
            there = pixels(page)
            assert len(np.unique(there.reshape(-1, 3), axis=0)) > 50  # a picture
            assert said == []
            if thing is not own:
                page.locator("#scrub").fill("11")
                assert differing(there, pixels(page)) > 50
