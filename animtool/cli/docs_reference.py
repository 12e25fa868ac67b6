"""Generated reference pages: all commands, all codes."""

from __future__ import annotations

import re
from collections.abc import Iterator
from itertools import groupby

import click

from animtool.core.rules import builtin_rules


def commands_markdown(name: str | None = None) -> str:
    """Return the reference of all commands, or of one, as Markdown."""
    from animtool.cli.main import COMMANDS, cli

    context = click.Context(cli, info_name="animtool")
    parts: list[str] = []
    if name is None:
        parts += [
            "# Commands",
            "Every command with its arguments and options, as `--help` has them.",
            *_table(
                ("command", "what it does"),
                [(f"[`{one}`](#animtool-{one})", COMMANDS[one][1]) for one in COMMANDS],
            ),
        ]
    for one in sorted(COMMANDS) if name is None else [name]:
        command = cli.get_command(context, one)
        assert command is not None
        parts += _command(command, click.Context(command, context, one), 2)
    return "\n\n".join(parts) + "\n"


def _command(
    command: click.Command, context: click.Context, level: int
) -> Iterator[str]:
    """Yield the paragraphs of a command and its subcommands."""
    yield f"{'#' * level} {context.command_path}"
    yield _prose(command.help or "")
    yield f"```text\n{' '.join(command.collect_usage_pieces(context))}\n```".replace(
        "```text\n", f"```text\n{context.command_path} "
    )
    rows = [
        record
        for one in command.get_params(context)
        if isinstance(one, click.Option)
        if (record := one.get_help_record(context))
    ]
    if rows:
        yield from _table(
            ("option", "what it does"),
            [(f"`{_cell(spelled)}`", _prose(text)) for spelled, text in rows],
        )
    if isinstance(command, click.Group):
        for name in command.list_commands(context):
            below = command.get_command(context, name)
            if below is not None:
                inner = click.Context(below, context, name)
                yield from _command(below, inner, level + 1)


def codes_markdown() -> str:
    """Return the list of all codes, by family, as Markdown."""
    rules = builtin_rules()
    parts = [
        "# Codes",
        "Each fault, warning and note has a code; `animtool explain CODE` prints it.",
    ]

    def family(code: str) -> str:
        return code.rstrip("0123456789")

    for name, codes in groupby(sorted(rules), family):
        parts.append(f"## {name}")
        parts += _table(
            ("code", "severity", "what it says"),
            [
                (f"[{one}](../rules/{one}.md)", rules[one].severity, rules[one].title)
                for one in codes
            ],
        )
    return "\n\n".join(parts) + "\n"


def _cell(text: str) -> str:
    """Return code for a table cell."""
    return text.replace("|", "\\|")


def _prose(text: str) -> str:
    """Escape Markdown in a help text."""
    joined = " ".join(text.replace("\b", "").split())
    return re.sub(r"([<>*_|\[\]])", r"\\\1", joined)


def _table(head: tuple[str, ...], rows: list[tuple[str, ...]]) -> list[str]:
    """Return a table, as one paragraph."""
    lines = [head, ("---",) * len(head), *rows]
    return ["\n".join(f"| {' | '.join(line)} |" for line in lines)]
