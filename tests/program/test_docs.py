"""The pages: links lead somewhere, tables are whole, what they name is there, their commands are understood."""

import ast
import io
import json
import re

import click
import pytest
from helpers.commands import READS, named, typed, understood, written
from helpers.pages import broken_links, ragged_tables
from helpers.paths import ROOT

from clothfit import load

PAGES = [ROOT / "README.md", ROOT / "CHANGELOG.md", *(ROOT / "docs").glob("*.md"), *(ROOT / "examples").rglob("*.md")]
HOUSE = (ROOT / "tests" / "program" / "test_house.py").read_text("utf-8")
ORDER = ast.literal_eval(re.search(r"^FOLDERS = (\[.*?\])", HOUSE, re.DOTALL | re.MULTILINE)[1])


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_the_links_and_modules_that_a_page_names_exist_and_its_tables_are_whole(path):
    assert list(broken_links(path)) == []
    assert ragged_tables(path) == []
    page = path.read_text("utf-8")
    quoted = re.findall(r"`(?:clothfit/)?((?:" + "|".join(ORDER) + r")/[\w/.]+)`", page)
    assert [name for name in quoted if not (ROOT / "clothfit" / name).exists()] == []
    dotted = re.findall(r"\bclothfit\.((?:" + "|".join(ORDER) + r")(?:\.\w+)*)", page)
    assert [name for name in dotted if not exists(name)] == []


def test_the_index_names_every_page_and_the_page_on_the_architecture_the_folders_in_order():
    index = (ROOT / "docs" / "README.md").read_text("utf-8")
    pages = {path.name for path in (ROOT / "docs").glob("*.md")} - {"README.md"}
    assert [name for name in pages if f"]({name})" not in index] == []
    page = (ROOT / "docs" / "architecture.md").read_text("utf-8")
    assert re.findall(r"^\| `(\w+)` \|", page, re.MULTILINE) == ORDER


def test_the_scene_format_names_every_field_and_shows_a_scene():
    page = (ROOT / "docs" / "scene.md").read_text("utf-8")
    schema = json.loads((ROOT / "schemas" / "scene.schema.json").read_text("utf-8"))
    of = (schema, *(schema["$defs"][name] for name in ("object", "collider")))
    assert [name for one in of for name in one["properties"] if f"| `{name}` |" not in page] == []
    scene, flags = re.findall(r"^```json\n(.*?)^```", page, re.DOTALL | re.MULTILINE)
    assert load(io.StringIO(scene)).warnings == ()
    changed = json.loads(scene) | json.loads(flags) | {"objects": json.loads(scene)["objects"]}
    changed["objects"][0] |= json.loads(flags)["objects"][0]
    assert load(io.StringIO(json.dumps(changed))).mode("wind") == "G"


def exists(name):
    """Whether a dotted name is a folder or module of the package, or a name in one."""
    place, last = ROOT / "clothfit" / name.replace(".", "/"), name.split(".")[-1]
    module = place.parent.with_suffix(".py")
    inside = module.is_file() and re.search(rf"\b{last}\b", module.read_text("utf-8"))
    return place.is_dir() or place.with_suffix(".py").is_file() or bool(inside)


ELSEWHERE = (
    "clothfit: command not found", "no such command …", "no such option …",
    "objects[0].springs[3]: vertex 144 does not exist (the object has 144 vertices)",
)  # fmt: skip
FACTS = ("… at a bound", "converged", "stalled", "limit", "failed", ".clothfit-….tmp")
"""What troubleshooting quotes that no text of the program has: what a shell and click say, an example of a message that
is put together, and words of results."""


def messages():
    """The texts of the program, with `…` where one has a value."""
    for path in (ROOT / "clothfit").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.JoinedStr):
                yield "".join(part.value if isinstance(part, ast.Constant) else "…" for part in node.values)
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                yield node.value


def test_the_errors_that_troubleshooting_quotes_are_messages_of_the_program():
    text = (ROOT / "docs" / "troubleshooting.md").read_text("utf-8")
    first = re.findall(r"^\| ([^|]*) \|", text, re.MULTILINE)
    quoted = [quote for cell in first for quote in re.findall(r"`([^`]+)`", cell)]
    known = list(messages())

    def is_said(quote):
        literal = max(re.split(r"…|\d+|: ", quote), key=len).strip()
        return len(literal) > 5 and any(literal in message for message in known)

    assert [quote for quote in quoted if not is_said(quote) and quote not in (*ELSEWHERE, *FACTS)] == []
    assert len(quoted) > 20


YOURS = {
    "bent.npz", "capture.c3d", "capture.npz", "capture.trc", "captures/{stem}.npz", "coarse.fitted.json",
    "curtain.json", "curtain.obj", "fine.json", "fitted.json", "flag.glb", "folds.json", "gusts.json", "hung.npz",
    "keys.json", "markers.csv", "one.json", "one.jsonl", "one.npz", "render.obj", "scans/shirt_*.ply", "scene.json",
    "shadow.csv", "sheet.json", "shirt.mdd", "shirt.obj", "shirt.pc2", "shot.pc2", "shot.usdc", "shot_*.obj",
    "shots/*.json", "two.json", "two.jsonl", "two.npz", "windy.json",
}  # fmt: skip
"""Files that readers of a page have."""


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_the_commands_of_a_page_are_understood_and_their_files_are_there(path):
    """A file that a command reads is an example, or an earlier command of the page writes it, or readers have it."""
    there, missing = set(YOURS), []
    for line in typed(path.read_text("utf-8")):
        command, values = understood(line)
        missing += [file for file in named(values, READS) if file not in there and not (ROOT / file).is_file()]
        there |= set(written(command, values))
    assert missing == []


def test_all_commands_of_code_are_seen():
    block = "```sh\nclothfit new plane \\\n    --size 2\n```\n"
    text = f"{block}Or `clothfit info\nplane.json`.\n```console\n$ clothfit warmup\n```\n"
    assert typed(text) == ["new plane --size 2", "info plane.json", "warmup"]
    for wrong in ("new plane --no-such-option", "new plane --damping 0.5"):  # the second one is a setting
        with pytest.raises(click.UsageError):
            understood(wrong)
    assert list(written(*understood("new shot_*.obj"))) == ["shot.json", "shot.json"]


def test_the_documents_are_short():
    words = {path: len(path.read_text("utf-8").split()) for path in PAGES if "examples" not in path.parts}
    assert words[ROOT / "README.md"] <= 1_300
    assert words[ROOT / "docs" / "architecture.md"] <= 1_300
    assert words[ROOT / "CHANGELOG.md"] <= 500
    assert sum(words.values()) <= 38_000
