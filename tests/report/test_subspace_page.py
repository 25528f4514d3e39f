"""The page and the picture of a cloth on a subspace beside its full simulation."""

import numpy as np
import pytest
from helpers.browsers import opened
from helpers.subspaces import model_of, moving, scene_of
from helpers.unpacking import unpacked, unpacked_positions

from clothfit.pictures.plots import comparison
from clothfit.report.page import page as page_of
from clothfit.report.subspace_contents import subspace_content
from clothfit.subspace.validation import compare

pytestmark = pytest.mark.slow  # compiles motions with inputs


@pytest.fixture(scope="module")
def over():
    scene = scene_of(moving(optimizationIterations=12))
    return compare(model_of(scene, 12, normals=True), scene, 30)


def test_it_plays_both_motions_and_says_what_both_cost(over):
    content = subspace_content(over, "m.npz")
    low, high = over.full.positions.min(), over.full.positions.max()
    for key, motion in (("fitted", over.own), ("target", over.full)):
        shown = unpacked_positions(content["motion"][key])
        np.testing.assert_allclose(shown, motion.positions, atol=1e-3 * (high - low))  # 16 bits of a box
    assert [each["name"] for each in content["beside"]] == ["in full"]
    tables = {each["id"]: each["rows"] for each in content["tables"]}
    assert [row[0] for row in tables["times"]] == [
        "state", "decode", "normals", "normals by regression", "a frame", "a full step"]
    assert [row[0][1] for row in tables["horizon"]] == [6, 12, 18, 24, 30]
    assert "parted" in content["headline"]["text"]  # 12 random vectors do not follow this cloth
    gaps = np.linalg.norm(over.own.positions - over.full.positions, axis=2)
    seen = unpacked(content["residuals"]["of_vertices"])
    np.testing.assert_allclose(seen, np.sqrt((gaps**2).mean(axis=0)), rtol=1e-3)  # of all frames
    assert content["words"]["own"] == "subspace"
    assert content["blocks"] == content["history"] == []


def test_a_browser_plays_them_side_by_side(over, started, tmp_path):
    path = tmp_path / "page.html"
    path.write_bytes(page_of(subspace_content(over, "m.npz")))
    with opened(started, path, {"width": 1000, "height": 700}) as (page, said):
        page.locator("button.pane").click()  # a narrow page shows one motion at first
        page.wait_for_selector("#panes .pane-name")
        names = page.locator("#panes .pane-name b").all_inner_texts()
        assert names == ["subspace", "in full"]
        assert page.locator("#show-target").inner_text() == "full simulation"
        assert "fitted" not in page.locator("body").inner_text().lower()
        assert said == []


def test_the_picture_has_the_first_coordinates_against_the_truth(over):
    figure = comparison(over)
    axes = {each.get_title("left").partition(":")[0]: each for each in figure.axes}
    chart = axes["first coordinates"]
    lines = [line for line in chart.get_lines() if line.get_linestyle() == "-"]
    for k, line in enumerate(lines):
        np.testing.assert_array_equal(line.get_ydata(), over.coordinates[0][:, k])
    assert len(lines) == 3
    dots = [line for line in chart.get_lines() if line.get_linestyle() == "None"]
    np.testing.assert_array_equal(dots[1].get_ydata(), over.projected(0)[:, 1])
    assert "spectrum, mean of the vertices" in axes
    assert "standard deviation of each vertex" in axes
