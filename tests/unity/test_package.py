"""The Unity package as files: what Unity asks of a package, and what it would not compile or serialise."""

import json
import re

import pytest
from helpers.paths import EXAMPLES
from helpers.unity import PACKAGE

from clothfit.base.version import __version__

FILES = sorted(
    path for path in PACKAGE.rglob("*")
    if path.suffix != ".meta" and path.name != "Samples~" and "Documentation~" not in path.parts  # not assets
)  # fmt: skip
SOURCES = [path for path in FILES if path.suffix == ".cs"]
MOST_LINES = 250


def test_every_file_and_folder_has_a_meta_with_a_guid_of_its_own():
    metas = [(path.parent / f"{path.name}.meta").read_text("utf-8") for path in FILES]
    found = [re.search(r"^guid: ([0-9a-f]{32})$", text, re.MULTILINE)[1] for text in metas]
    assert len(set(found)) == len(FILES) > 30
    assert len(list(PACKAGE.rglob("*.meta"))) == len(FILES)


def test_the_manifest_names_the_package_and_the_code_of_the_editor_is_compiled_for_the_editor_only():
    names = "package.json", "Runtime/Clothfit.Runtime.asmdef", "Editor/Clothfit.Editor.asmdef"
    manifest, runtime, editor = (json.loads((PACKAGE / name).read_text("utf-8")) for name in names)
    assert (manifest["name"], manifest["unity"], manifest["version"]) == (PACKAGE.name, "2021.3", __version__)
    assert "dependencies" not in manifest
    assert (runtime["includePlatforms"], runtime["references"]) == ([], [])
    assert (editor["includePlatforms"], editor["references"]) == (["Editor"], ["Clothfit.Runtime"])
    used = {path.name for path in SOURCES if "UnityEditor" in path.read_text("utf-8")}
    assert used <= {path.name for path in (PACKAGE / "Editor").glob("*.cs")}


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: path.stem)
def test_a_source_is_short_and_named_after_what_is_in_it(path):
    text = path.read_text("utf-8")
    assert len(text.splitlines()) <= MOST_LINES
    behaviours = re.findall(r"class (\w+) : (?:MonoBehaviour|ClothfitObstacle|ClothfitMover)", text)
    assert behaviours in ([], [path.stem])  # else Unity does not find the component
    assert "\t" not in text
    assert all(len(line) <= 145 for line in text.splitlines())


def test_the_player_of_subspaces_is_that_of_the_clients_and_the_licence_that_of_the_program():
    own = PACKAGE / "Runtime" / "Playback" / "Subspace.cs"
    assert own.read_bytes() == (EXAMPLES / "clients" / "Subspace.cs").read_bytes()
    assert (PACKAGE / "LICENSE.md").read_bytes() == (PACKAGE.parents[2] / "LICENSE").read_bytes()


def test_the_documentation_is_where_the_package_manager_looks_for_it_and_its_links_lead_somewhere():
    page = PACKAGE / "Documentation~" / f"{PACKAGE.name}.md"
    links = re.findall(r"\]\(([^)]+)\)", page.read_text("utf-8"))
    assert links
    assert all((page.parent / link).is_file() for link in links)


def test_the_sample_is_a_scene_of_the_package_s_components():
    (sample,) = json.loads((PACKAGE / "package.json").read_text("utf-8"))["samples"]
    text = (PACKAGE / sample["path"] / "Curtain.unity").read_text("utf-8")
    guids = {
        re.search(r"^guid: (\w+)$", (path.parent / f"{path.name}.meta").read_text("utf-8"), re.MULTILINE)[1]: path.stem
        for path in SOURCES
    }
    used = [guids[guid] for guid in re.findall(r"m_Script: \{fileID: 11500000, guid: (\w+), type: 3\}", text)]
    assert used == ["ClothfitScene", "ClothfitCloth", "ClothfitFixer", "ClothfitWind"]
    made = set(re.findall(r"^--- !u!\d+ &(\d+)$", text, re.MULTILINE))
    assert set(re.findall(r"\{fileID: (\d{4})\}", text)) <= made
    fields = re.findall(r"type: 3\}\n((?:  \w+: .*\n)*)", text)
    for component, own in zip(used, fields, strict=True):
        source = next(path for path in SOURCES if path.stem == component).read_text("utf-8")
        assert all(f" {name}" in source for name in re.findall(r"^  (\w+):", own, re.MULTILINE))


@pytest.mark.slow  # starts a compiler
def test_the_package_s_own_tests_pass(harness):
    names = re.findall(r"\[Test\]\s+public void (\w+)", (PACKAGE / "Tests/Editor/SceneTests.cs").read_text("utf-8"))
    assert harness("tests", harness.path.parent / "Clothfit.Tests.dll") == names


@pytest.mark.slow  # starts a compiler
def test_the_menu_and_that_unity_serialises_all_fields_and_all_settings_have_a_tooltip(harness):
    assert harness("rules") == ["11 components"]
    names = ["Export", "Estimate", "Cancel", "Import fitted", "Simulate and play", "Show target", "New scene"]
    assert harness("menus") == [f"Clothfit/{name}" for name in names]
