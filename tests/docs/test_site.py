"""What the site adds to the pages: where links lead, and pages that play."""

from __future__ import annotations

import sys
from pathlib import Path
from runpy import run_path
from types import SimpleNamespace
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]


class Files(dict[str, str]):
    """The files of a site, by their place in it."""

    def get_file_from_path(self, path: str) -> str | None:
        return self.get(path)


@pytest.fixture(scope="module")
def hooks() -> dict[str, Any]:
    pytest.importorskip("mkdocs", reason="no mkdocs (extra: docs)")
    before = list(sys.path)
    found = run_path(str(ROOT / ".ci/site_hooks.py"))
    sys.path[:] = before
    return found


def made(hooks: dict[str, Any], name: str, text: str, *files: str) -> str:
    page = SimpleNamespace(file=SimpleNamespace(src_uri=name), meta={})
    there = Files(dict.fromkeys(files, ""))
    return str(hooks["on_page_markdown"](text, page, None, there))


@pytest.mark.parametrize(
    ("name", "link", "there", "leads"),
    [
        ("faq.md", "howto/ci.md", "howto/ci.md", "[x](howto/ci.md)"),
        ("howto/ci.md", "../faq.md#a", "faq.md", "[x](../faq.md#a)"),
        (
            "howto/ci.md",
            "../../../samples/ci/README.md",
            "samples/ci/index.md",
            "[x](../samples/ci/index.md)",
        ),
        ("index.md", "animtool/docs/faq.md", "faq.md", "[x](faq.md)"),
        ("index.md", "tests/wheels/README.md", "", "x"),
        ("samples/ci/index.md", "../cape/README.md", "samples/cape/index.md",
         "[x](../../samples/cape/index.md)"),
        ("faq.md", "https://a.b/c", "", "[x](https://a.b/c)"),
        ("faq.md", "#anchor", "", "[x](#anchor)"),
        # What is wrong stays, and mkdocs says so.
        ("faq.md", "missing.md", "", "[x](missing.md)"),
    ],
)  # fmt: skip
def test_links(
    hooks: dict[str, Any], name: str, link: str, there: str, leads: str
) -> None:
    assert made(hooks, name, f"[x]({link})", there) == leads


def test_a_page_that_plays_is_shown_below_its_command(hooks: dict[str, Any]) -> None:
    text = (
        "```console\n$ animtool info a\n```\n"
        "```console\n$ animtool preview a -o out/b.html\n$ animtool info a\n```\n"
    )
    page = made(hooks, "tutorials/t.md", text, "tutorials/t/b.html")
    assert page.count("<iframe") == 1
    assert page.startswith(text)
    assert 'src="t/b.html"' in page
    assert made(hooks, "tutorials/t.md", text) == text
