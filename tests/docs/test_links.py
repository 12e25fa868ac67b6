"""Links of the documentation lead to files and headings that are there."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "animtool/docs"
PAGES = [
    ROOT / "README.md",
    *sorted(path for path in DOCS.rglob("*.md")),
    *sorted(path for path in ROOT.glob("samples/*/README.md")),
]
FENCED = re.compile(r"^```.*?^```", re.M | re.S)
LINK = re.compile(r"\]\(([^)\s]+)\)")
# Pages that the site makes of records.
MADE = {DOCS / "reference/commands.md", DOCS / "reference/codes.md"}


@cache
def prose(path: Path) -> str:
    """Return a page without its blocks of code."""
    return FENCED.sub("", path.read_text("utf-8"))


@cache
def anchors(path: Path) -> set[str]:
    """Return the anchors of the headings of a page."""
    heads = re.findall(r"^#+ (.+)$", prose(path), re.M)
    return {re.sub(r"[^\w -]", "", head).lower().replace(" ", "-") for head in heads}


def broken(path: Path) -> list[str]:
    """Return the links of a page that lead nowhere."""
    found = []
    for link in LINK.findall(prose(path)):
        if "://" in link:
            continue
        name, _, anchor = link.partition("#")
        target = (path.parent / name).resolve() if name else path
        if target in MADE:
            continue
        if not target.exists() or (anchor and anchor not in anchors(target)):
            found.append(link)
    return found


@pytest.mark.parametrize("folder", ["README.md", "animtool/docs", "samples"])
def test_links_lead_somewhere(folder: str) -> None:
    pages = [path for path in PAGES if path.is_relative_to(ROOT / folder)]
    assert pages
    found = {str(p.relative_to(ROOT)): links for p in pages if (links := broken(p))}
    assert found == {}


def test_pages_are_in_the_contents_of_the_site() -> None:
    listed = set(re.findall(r"([\w/-]+\.md)$", (ROOT / "mkdocs.yml").read_text(), re.M))
    names = {
        path.relative_to(DOCS).as_posix()
        for path in DOCS.rglob("*.md")
        if path.parent.name != "rules"
    }
    made = {path.relative_to(DOCS).as_posix() for path in MADE}
    assert listed == names | made | {"index.md"}
