"""The pages in docs/: links lead somewhere, the reference of the commands is what the program says."""

import ast
import io
import json
import re
from functools import cache
from importlib import util

import pytest
from helpers.failing import pattern, rows
from helpers.paths import ROOT

from clothfit import load

PAGES = [ROOT / "README.md", ROOT / "CHANGELOG.md", *(ROOT / "docs").glob("*.md"), *(ROOT / "examples").glob("*.md")]
HOUSE = (ROOT / "tests" / "program" / "test_house.py").read_text("utf-8")
ORDER = ast.literal_eval(re.search(r"^FOLDERS = (\[.*?\])", HOUSE, re.DOTALL | re.MULTILINE)[1])
LINK = re.compile(r"\]\(([^)\s]+)\)")


def without_code(text):
    """A page without its code, in which nothing is a link or a title."""
    return re.sub(r"^```.*?^```|`[^`\n]+`(?!\]\()", "", text, flags=re.DOTALL | re.MULTILINE)


@cache
def anchors(path):
    """What a link to a part of a page may name: its titles in lower case, spaces as hyphens, without punctuation."""
    text = re.sub(r"^```.*?^```", "", path.read_text("utf-8"), flags=re.DOTALL | re.MULTILINE)
    titles = re.findall(r"^#+ (.+)$", text, re.MULTILINE)
    slugs = [re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles]
    return {f"{slug}-{slugs[:i].count(slug)}".removesuffix("-0") for i, slug in enumerate(slugs)}


def broken(path):
    """The links of a page that lead nowhere."""
    for link in LINK.findall(without_code(path.read_text("utf-8"))):
        name, _, anchor = link.partition("#")
        to = (path.parent / name).resolve() if name else path
        if ":" not in link and (not to.exists() or (anchor and anchor not in anchors(to))):
            yield link


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_the_links_of_a_page_lead_somewhere(path):
    assert list(broken(path)) == []


def test_a_link_that_leads_nowhere_is_found(tmp_path):
    page = tmp_path / "page.md"
    page.write_text("# A b, c\n\n[x](#a-b-c) [y](#d) [z](gone.md) `[n](one)`\n\n```\n# d\n[n](one)\n```\n", "utf-8")
    assert list(broken(page)) == ["#d", "gone.md"]


@pytest.mark.parametrize("path", sorted((ROOT / "docs").glob("*.md")), ids=lambda path: path.name)
def test_the_index_names_every_page(path):
    assert path.name == "README.md" or f"]({path.name})" in (ROOT / "docs" / "README.md").read_text("utf-8")


def test_the_reference_of_the_commands_is_what_the_program_says():
    where = util.spec_from_file_location("commands_page", ROOT / "docs" / "commands.py")
    made = util.module_from_spec(where)
    where.loader.exec_module(made)
    assert made.PAGE.read_text("utf-8") == made.page(), "python docs/commands.py writes it again"


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_the_rows_of_a_table_have_as_many_cells_as_its_head(path):
    text = re.sub(r"^```.*?^```", "", path.read_text("utf-8"), flags=re.DOTALL | re.MULTILINE)
    tables = re.findall(r"(?:^\|.*\n)+", text, re.MULTILINE)
    widths = [{len(re.findall(r"(?<!\\)\|", row)) for row in table.splitlines()} for table in tables]
    assert [table[:80] for table, width in zip(tables, widths, strict=True) if len(width) > 1] == []


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


def test_the_page_on_the_architecture_names_the_folders_in_order():
    page = (ROOT / "docs" / "architecture.md").read_text("utf-8")
    assert re.findall(r"^\| `(\w+)` \|", page, re.MULTILINE) == ORDER


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_the_modules_and_folders_that_a_page_names_exist(path):
    page = path.read_text("utf-8")
    quoted = re.findall(r"`(?:clothfit/)?((?:" + "|".join(ORDER) + r")/[\w/.]+)`", page)
    assert [name for name in quoted if not (ROOT / "clothfit" / name).exists()] == []
    dotted = re.findall(r"\bclothfit\.((?:" + "|".join(ORDER) + r")(?:\.\w+)*)", page)
    assert [name for name in dotted if not exists(name)] == []


def exists(name):
    """Whether a dotted name is a folder or module of the package, or a name in one."""
    place, last = ROOT / "clothfit" / name.replace(".", "/"), name.split(".")[-1]
    module = place.parent.with_suffix(".py")
    inside = module.is_file() and re.search(rf"\b{last}\b", module.read_text("utf-8"))
    return place.is_dir() or place.with_suffix(".py").is_file() or bool(inside)


WARNED = (
    "clothfit: command not found", "compiling for this machine: …", "warning: … steps of … s will not stay stable",
)  # fmt: skip
FACTS = ("… not shown by the motion", "… at a bound", "converged", "stalled", "limit", "failed", ".clothfit-….tmp")
"""What troubleshooting quotes that is no error: what a shell says, warnings, and words of results."""


def test_the_errors_that_troubleshooting_quotes_are_errors():
    text = (ROOT / "docs" / "troubleshooting.md").read_text("utf-8")
    first = re.findall(r"^\| ([^|]*) \|", text, re.MULTILINE)
    quoted = [quote for cell in first for quote in re.findall(r"`([^`]+)`", cell)]
    known = [row.message for row in rows()]

    def is_error(quote):
        return any(pattern(message).search(quote) or quote.rstrip(" …") in message for message in known)

    assert [quote for quote in quoted if not is_error(quote) and quote not in (*WARNED, *FACTS)] == []
    assert len(quoted) > 20
