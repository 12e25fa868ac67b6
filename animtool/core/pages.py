"""The documentation pages, which are installed as Markdown."""

from __future__ import annotations

import re
from functools import cache
from importlib import resources
from pathlib import Path
from typing import cast

from animtool.core.arguments import argument
from animtool.core.errors import Fault, OptionError
from animtool.core.names import name_hint
from animtool.core.record import dataclass

_DOCS = resources.files("animtool") / "docs"
# Folders of pages, and the kind of their pages.
PAGE_KINDS = {
    "tutorials": "Tutorials",
    "howto": "How-to guides",
    "reference": "Reference",
    "explanation": "Explanation",
    "": "More",
}
# Names of earlier pages, and the pages that refer to their new location.
MOVED_PAGES = {"guide": "reference/index", "formats": "reference/files"}
# Pages by the subject that users search for.
PAGE_BY_SUBJECT = {
    "bring": "howto/fbx-and-gltf",
    "cape": "howto/cloth-and-hair",
    "cores": "reference/batches",
    "ignore": "reference/checking",
    "jobs": "reference/batches",
    "mixamo": "howto/fbx-and-gltf",
    "profile": "reference/checking",
    "resume": "reference/batches",
    "silence": "reference/checking",
    "simulate": "reference/simulations",
    "skirt": "howto/cloth-and-hair",
    "suppress": "reference/checking",
    "units": "howto/units-and-axes",
}
# Number of pages in a hint on a topic.
MAX_HINTED_PAGES = 5


@dataclass(frozen=True, slots=True)
class PageEntry:
    """Name and title of an installed documentation page.

    Attributes:
        name: Path below ``docs``, without suffix, such as ``howto/ci``.
        title: Its first heading.
    """

    name: str
    title: str

    @property
    def kind(self) -> str:
        """Kind of the page: one of the values of `PAGE_KINDS`."""
        folder = self.name.partition("/")[0] if "/" in self.name else ""
        return PAGE_KINDS.get(folder, PAGE_KINDS[""])


@cache
def all_pages() -> tuple[PageEntry, ...]:
    """Return all pages except those of rules, sorted by kind and name."""
    docs = cast(Path, _DOCS)
    kind_order = list(PAGE_KINDS.values())
    entries = [
        PageEntry(path.relative_to(docs).with_suffix("").as_posix(), _page_title(path))
        for path in docs.rglob("*.md")
        if path.relative_to(docs).parts[0] != "rules"
    ]
    entries.sort(key=lambda page: (kind_order.index(page.kind), page.name))
    return tuple(entries)


def page_markdown(page: PageEntry) -> str:
    """Return the Markdown text of a page."""
    return (_DOCS / f"{page.name}.md").read_text("utf-8")


def find_page(topic: str) -> PageEntry:
    """Return the page that a topic names, or the only page about it (else CLI009).

    A topic is ``desk-lamp`` or ``tutorials/desk-lamp``, in any case.

    >>> find_page("Desk-Lamp").name
    'tutorials/desk-lamp'
    """
    name = topic.lower().removesuffix(".md").strip("/")
    name = (MOVED_PAGES | PAGE_BY_SUBJECT).get(name, name)
    pages = all_pages()
    matches = [page for page in pages if page.name == name]
    matches = matches or [page for page in pages if page.name.split("/")[-1] == name]
    candidates = [page for page in pages if name in page.name.split("/")[-1].split("-")]
    if len(matches) == 1 or (not matches and len(candidates) == 1):
        return (matches or candidates)[0]
    if matches:
        message = f"{topic!r} names several pages"
        hint = f"write one of {', '.join(page.name for page in matches)}"
        raise OptionError(Fault("CLI009", message, hint=hint))
    pages_on_topic = _defining_pages(name) if name.strip() else []
    if len(pages_on_topic) == 1:
        return pages_on_topic[0]
    if name.strip() and not pages_on_topic:
        pages_on_topic = _page_with_most_mentions(name)
    names = ", ".join(page.name for page in pages_on_topic[:MAX_HINTED_PAGES])
    hint = f"it is a subject of {names}"
    if not names:
        hint = name_hint(name, [page.name.split("/")[-1] for page in pages])
        if hint.startswith("allowed"):
            hint = f"{argument('list')} lists the pages"
    raise OptionError(Fault("CLI009", f"unknown page {topic!r}", hint=hint))


def _defining_pages(topic: str) -> list[PageEntry]:
    """Return the pages with a topic in a heading, or at the start of a table's row."""
    headings = re.compile(r"^#+ (.+)$", re.MULTILINE)
    row_pattern = re.compile(rf"^\| `{re.escape(topic)}`", re.MULTILINE | re.IGNORECASE)
    return [
        page
        for page in all_pages()
        if page.name != "changelog"
        and _count_mentions(page, topic)
        and (
            any(topic in h.lower() for h in headings.findall(page_markdown(page)))
            or row_pattern.search(page_markdown(page))
        )
    ]


def _page_with_most_mentions(topic: str) -> list[PageEntry]:
    """Return the page that mentions a topic most often, in a list; empty for none."""
    pages = [page for page in all_pages() if page.name != "changelog"]
    best_page = max(pages, key=lambda page: _count_mentions(page, topic))
    return [best_page] if _count_mentions(best_page, topic) else []


def _count_mentions(page: PageEntry, word: str) -> int:
    """Return how many times a page contains a word."""
    if not word:
        return 0
    return len(re.findall(rf"\b{re.escape(word)}\b", page_markdown(page).lower()))


def _page_title(path: Path) -> str:
    with path.open("rb") as file:
        return file.readline().decode("utf-8").lstrip("# ").strip()
