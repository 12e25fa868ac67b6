"""``animtool docs``: opens, prints or lists pages of the documentation."""

from __future__ import annotations

import re
from pathlib import Path
from typing import ClassVar

import click

from animtool.cli.console import Console
from animtool.cli.help import command
from animtool.cli.options import common_options, format_option
from animtool.core.pages import (
    PAGE_KINDS,
    PageEntry,
    all_pages,
    find_page,
    page_markdown,
)
from animtool.core.record import dataclass

# Generated pages.
COMMANDS_PAGE = PageEntry("reference/commands", "Commands")
CODES_PAGE = PageEntry("reference/codes", "Codes")
_CODE = re.compile(r"[A-Za-z]{2,8}[0-9]{3}")
SITE_FOLDER = Path(__file__).parents[2] / "build/site"


@dataclass(frozen=True, slots=True)
class DocsPage:
    """A page; it includes its text if the page was requested by name."""

    entry: PageEntry
    page: str | None = None
    json_keys: ClassVar[str] = "*entry{name title kind} page?"


@dataclass(frozen=True, slots=True)
class DocsReport:
    """Report of all pages, or of the requested page."""

    pages: list[DocsPage]
    json_keys: ClassVar[str] = "'docs' pages"


def _docs_report(topic: str | None) -> DocsReport:
    if topic is None:
        return DocsReport([DocsPage(page) for page in _sorted_pages()])
    page = _page_of(topic)
    return DocsReport([DocsPage(page, _page_text(page))])


@command(
    epilog="""\b
Examples:
  animtool docs
  animtool docs desk-lamp
  animtool docs --list"""
)
@click.argument("topic", required=False)
@click.option("--list", "lists_pages", is_flag=True, help="List the pages.")
@click.option("--print", "is_printed", is_flag=True, help="Print, and open no browser.")
@format_option
@common_options
@click.pass_obj
def docs(
    console: Console,
    /,
    topic: str | None,
    lists_pages: bool,
    is_printed: bool,
    report_format: str,
) -> None:
    """Open the page of a TOPIC in the browser, or print it.

    A TOPIC is the name of a page, a command or a code. If the site was built (mkdocs
    build, in a checkout) and a browser is available, the page opens there; otherwise
    it is printed. Without a TOPIC the site opens, or the pages are listed.
    """
    import sys

    if report_format == "json":
        console.result_json(_docs_report(None if lists_pages or not topic else topic))
        return
    if lists_pages:
        _print_page_list(console)
        return
    page = COMMANDS_PAGE if topic is None else _page_of(topic)
    site_page = "index" if topic is None else page.name
    opens_browser = not is_printed and sys.stdout.isatty()
    if opens_browser and _open_in_browser(console, site_page):
        return
    if topic is None:
        _print_page_list(console)
        return
    console.document(_page_text(page))


def _page_of(topic: str) -> PageEntry:
    """Return the page of a topic, of a code, or of a command."""
    from animtool.cli.main import COMMANDS
    from animtool.core.rules import find_rule

    for entry in (COMMANDS_PAGE, CODES_PAGE):
        if topic.lower() in {entry.name, entry.name.split("/")[-1]}:
            return entry
    if _CODE.fullmatch(topic):
        rule = find_rule(topic)
        return PageEntry(f"rules/{rule.code}", rule.title)
    pages = {page.name.split("/")[-1] for page in all_pages()}
    if topic in COMMANDS and topic not in pages:
        return PageEntry(f"{COMMANDS_PAGE.name}#animtool-{topic}", topic)
    return find_page(topic)


def _page_text(page: PageEntry) -> str:
    """Return the Markdown of a page, generated or stored."""
    from animtool.cli.docs_reference import codes_markdown, commands_markdown
    from animtool.cli.explain import ignore_section
    from animtool.core.rules import find_rule, page_text

    if page == CODES_PAGE:
        return codes_markdown()
    name, _, anchor = page.name.partition("#animtool-")
    if name == COMMANDS_PAGE.name:
        return commands_markdown(anchor or None)
    if name.startswith("rules/"):
        code = name.removeprefix("rules/")
        text = page_text(code)
        return text + ignore_section(find_rule(code)) if text else f"# {page.title}\n"
    return page_markdown(page)


def _open_in_browser(console: Console, name: str) -> bool:
    """Open a page of the local site in the browser; return whether it opened."""
    from animtool.preview.show import has_browser, open_browser

    file, _, anchor = name.partition("#")
    path = SITE_FOLDER / f"{file}.html"
    if not path.is_file() or not has_browser():
        return False
    address = path.as_uri() + (f"#{anchor}" if anchor else "")
    if not open_browser(address):
        return False
    console.say(f"opened {path}")
    return True


def _sorted_pages() -> list[PageEntry]:
    """Return all pages sorted by kind."""
    order = list(PAGE_KINDS.values())
    pages = [*all_pages(), COMMANDS_PAGE, CODES_PAGE]
    return sorted(pages, key=lambda page: (order.index(page.kind), page.name))


def _print_page_list(console: Console) -> None:
    pages = _sorted_pages()
    name_width = max(len(page.name) for page in pages)
    kind = ""
    for page in pages:
        if page.kind != kind:
            kind = page.kind
            console.result(kind)
        console.result(f"  {page.name:{name_width}}  {page.title}")
