"""What is wrong with a page in Markdown: links that lead nowhere, tables whose rows differ in width."""

import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

BLOCK = re.compile(r"^```.*?^```", re.DOTALL | re.MULTILINE)
LINK = re.compile(r"\]\(([^)\s]+)\)")


@cache
def anchors(path: Path) -> set[str]:
    """What a link to a part of a page may name: its titles in lower case, spaces as hyphens, without punctuation."""
    titles = re.findall(r"^#+ (.+)$", BLOCK.sub("", path.read_text("utf-8")), re.MULTILINE)
    slugs = [re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles]
    return {f"{slug}-{slugs[:i].count(slug)}".removesuffix("-0") for i, slug in enumerate(slugs)}


def broken_links(path: Path) -> Iterator[str]:
    """The links of a page that lead nowhere; in code nothing is a link."""
    text = re.sub(r"`[^`\n]+`(?!\]\()", "", BLOCK.sub("", path.read_text("utf-8")))
    for link in LINK.findall(text):
        name, _, anchor = link.partition("#")
        to = (path.parent / name).resolve() if name else path
        if ":" not in link and (not to.exists() or (anchor and anchor not in anchors(to))):
            yield link


def ragged_tables(path: Path) -> list[str]:
    """How the tables begin of which not all rows have as many cells."""
    tables = re.findall(r"(?:^\|.*\n)+", BLOCK.sub("", path.read_text("utf-8")), re.MULTILINE)
    widths = [{len(re.findall(r"(?<!\\)\|", row)) for row in table.splitlines()} for table in tables]
    return [table[:80] for table, width in zip(tables, widths, strict=True) if len(width) > 1]
