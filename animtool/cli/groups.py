"""Groups of commands that are imported when they are called."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from typing import Any

import click


class LazyGroup(click.Group):
    """A click group that imports a command's module when it is called.

    Attributes:
        table: ``module:object`` and one-line help by command name.
        sections: Command names by heading of the help.
        other_names: Command by its name in other tools.
    """

    def __init__(
        self,
        *args: Any,
        table: Mapping[str, tuple[str, str]],
        sections: Mapping[str, tuple[str, ...]] | None = None,
        other_names: Mapping[str, str] | None = None,
        **options: Any,
    ) -> None:
        super().__init__(*args, **options)
        self.table = table
        self.sections = sections or {"Commands": tuple(sorted(table))}
        self.other_names = other_names or {}

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the names of the commands."""
        del ctx
        return sorted(self.table)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import and return a command."""
        del ctx
        if cmd_name not in self.table:
            return None
        module, _, name = self.table[cmd_name][0].partition(":")
        command: click.Command = getattr(importlib.import_module(module), name)
        return command

    def format_commands(
        self, ctx: click.Context, formatter: click.HelpFormatter
    ) -> None:
        """List the commands from the table without importing them."""
        del ctx
        from animtool.cli.help import write_sections

        write_sections(
            formatter,
            {
                title: [(name, self.table[name][1]) for name in names]
                for title, names in self.sections.items()
            },
        )

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Resolve ``help COMMAND``; suggest a command for an unknown name."""
        if args[:1] == ["help"] and "help" not in self.table:
            args = [*args[1:2], "--help"]
            if len(args) == 1:
                click.echo(ctx.get_help(), color=ctx.color)
                ctx.exit()
        if args and args[0] not in self.table and not args[0].startswith("-"):
            from difflib import get_close_matches

            close_matches = get_close_matches(args[0], self.table, 1)
            suggestion = self.other_names.get(args[0]) or next(iter(close_matches), "")
            hint = f"; did you mean {suggestion!r}?" if suggestion else ""
            hint = hint or f"; {ctx.command_path} --help lists the commands"
            ctx.fail(f"unknown command {args[0]!r}{hint}")
        return super().resolve_command(ctx, args)
