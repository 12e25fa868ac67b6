"""Generated reference pages of all commands and all codes."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from itertools import groupby

import click

from animtool.core.rules import builtin_rules


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
    lines = [header, ("---",) * len(header), *rows]
    return ["\n".join(f"| {' | '.join(cells)} |" for cells in lines)]
