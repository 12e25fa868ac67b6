"""``animtool docs``: opens, prints or lists pages of the documentation."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from itertools import groupby
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
    """Return the Markdown of a page; those of commands and codes are generated."""
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
    """Return installed and generated pages, sorted by kind, then by name."""
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


def commands_markdown(name: str | None = None) -> str:
    """Return the reference of all commands, or of one command, as Markdown."""
    from animtool.cli.main import COMMANDS, cli

    context = click.Context(cli, info_name="animtool")
    paragraphs: list[str] = []
    if name is None:
        rows = [(f"[`{n}`](#animtool-{n})", text) for n, (_, text) in COMMANDS.items()]
        paragraphs += [
            "# Commands",
            "Every command with its arguments and options, as `--help` has them.",
            *_table(("command", "what it does"), rows),
        ]
    for command_name in sorted(COMMANDS) if name is None else [name]:
        command = cli.get_command(context, command_name)
        assert command is not None
        command_context = click.Context(command, context, command_name)
        paragraphs += _command_paragraphs(command, command_context, 2)
    return "\n\n".join(paragraphs) + "\n"


def _command_paragraphs(
    command: click.Command, context: click.Context, level: int
) -> Iterator[str]:
    """Yield the paragraphs of a command and its subcommands."""
    yield f"{'#' * level} {context.command_path}"
    yield _escape_prose(command.help or "")
    usage_parts = command.collect_usage_pieces(context)
    yield f"```text\n{' '.join([context.command_path, *usage_parts])}\n```"
    rows = [
        ("`{}`".format(record[0].replace("|", "\\|")), _escape_prose(record[1]))
        for parameter in command.get_params(context)
        if isinstance(parameter, click.Option)
        if (record := parameter.get_help_record(context))
    ]
    if rows:
        yield from _table(("option", "what it does"), rows)
    if isinstance(command, click.Group):
        for name in command.list_commands(context):
            subcommand = command.get_command(context, name)
            if subcommand is not None:
                subcontext = click.Context(subcommand, context, name)
                yield from _command_paragraphs(subcommand, subcontext, level + 1)


def codes_markdown() -> str:
    """Return the list of all codes, by family, as Markdown."""
    from animtool.core.rules import builtin_rules

    rules = builtin_rules()
    paragraphs = [
        "# Codes",
        "Each fault, warning and note has a code; `animtool explain CODE` prints it.",
    ]

    def family(code: str) -> str:
        return code.rstrip("0123456789")

    for name, codes in groupby(sorted(rules), family):
        rows = [
            (f"[{code}](../rules/{code}.md)", rules[code].severity, rules[code].title)
            for code in codes
        ]
        header = ("code", "severity", "what it says")
        paragraphs += [f"## {name}", *_table(header, rows)]
    return "\n\n".join(paragraphs) + "\n"


def _escape_prose(text: str) -> str:
    """Escape the Markdown syntax in a help text."""
    single_line = " ".join(text.replace("\b", "").split())
    return re.sub(r"([<>*_|\[\]])", r"\\\1", single_line)


def _table(header: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> list[str]:
    """Return a Markdown table as one paragraph."""
    table_rows = [header, ("---",) * len(header), *rows]
    return ["\n".join(f"| {' | '.join(row)} |" for row in table_rows)]
