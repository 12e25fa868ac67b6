"""Generated reference pages of all commands and all codes."""

from __future__ import annotations

import re
from collections.abc import Iterator
from itertools import groupby

import click

from animtool.core.rules import builtin_rules


def commands_markdown(name: str | None = None) -> str:
    """Return the reference of all commands, or of one command, as Markdown."""
    from animtool.cli.main import COMMANDS, cli

    context = click.Context(cli, info_name="animtool")
    paragraphs: list[str] = []
    if name is None:
        paragraphs += [
            "# Commands",
            "Every command with its arguments and options, as `--help` has them.",
            *_table(
                ("command", "what it does"),
                [
                    (
                        f"[`{command_name}`](#animtool-{command_name})",
                        COMMANDS[command_name][1],
                    )
                    for command_name in COMMANDS
                ],
            ),
        ]
    for command_name in sorted(COMMANDS) if name is None else [name]:
        command = cli.get_command(context, command_name)
        assert command is not None
        paragraphs += _command_paragraphs(
            command, click.Context(command, context, command_name), 2
        )
    return "\n\n".join(paragraphs) + "\n"


def _command_paragraphs(
    command: click.Command, context: click.Context, level: int
) -> Iterator[str]:
    """Yield the paragraphs of a command and its subcommands."""
    yield f"{'#' * level} {context.command_path}"
    yield _escape_prose(command.help or "")
    yield f"```text\n{' '.join(command.collect_usage_pieces(context))}\n```".replace(
        "```text\n", f"```text\n{context.command_path} "
    )
    option_rows = [
        record
        for parameter in command.get_params(context)
        if isinstance(parameter, click.Option)
        if (record := parameter.get_help_record(context))
    ]
    if option_rows:
        yield from _table(
            ("option", "what it does"),
            [
                ("`{}`".format(option_text.replace("|", "\\|")), _escape_prose(text))
                for option_text, text in option_rows
            ],
        )
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
        paragraphs.append(f"## {name}")
        paragraphs += _table(
            ("code", "severity", "what it says"),
            [
                (
                    f"[{other}](../rules/{other}.md)",
                    rules[other].severity,
                    rules[other].title,
                )
                for other in codes
            ],
        )
    return "\n\n".join(paragraphs) + "\n"


def _escape_prose(text: str) -> str:
    """Escape the Markdown syntax in a help text."""
    single_line = " ".join(text.replace("\b", "").split())
    return re.sub(r"([<>*_|\[\]])", r"\\\1", single_line)


def _table(header: tuple[str, ...], rows: list[tuple[str, ...]]) -> list[str]:
    """Return a Markdown table as one paragraph."""
    table_rows = [header, ("---",) * len(header), *rows]
    return ["\n".join(f"| {' | '.join(line)} |" for line in table_rows)]
