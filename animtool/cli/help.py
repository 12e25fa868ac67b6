"""Help: ``-h`` lists the common options, ``--help`` all of them, by group."""

from __future__ import annotations

import importlib
import os
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import click

# Of options that several commands share, and of those of one; headings in this order.
_GROUPS: dict[str, str] = {
    "Source": (
        "take take-a take-b source-prim source-prim-a source-prim-b units "
        "up source-fps positions rest strip-namespace clamp rig template "
        "cameras camera camera-name landmarks subject static remap dropped set "
        "scene variants vary exclude shot cut handles cut-start first-timecode "
        "path-mapping base clip targets over suite costs"
    ),
    "Solve": (
        "match chains pose method tolerance angle-tolerance restarts seed "
        "time-budget joints rest-weight smooth to map by preset target-preset "
        "feet hands spikes noise cutoff drift head neutral gaps swaps calibrate "
        "acceleration people gate min-angle moved shortest longest blend "
        "repeats first last"
    ),
    "Picture": ("size sheet light caption numbers show turntable findings open watch"),
    "Checks": (
        "select ignore severity profile exit-zero fix diff warn-above weight-tolerance "
        "missed missed-degrees"
    ),
    "Output": (
        "output as split rig-layer prim-path placement force-fit bones to-units to-up "
        "root-motion sparse keep-curves reduce reduce-at physics write-map "
        "write-rig write-template keep-stopped until name overwrite "
        "skip-existing check"
    ),
    "Time": "fps range start samples keep-samples",
    "Caches": "deform velocities normals chunk",
    "Run": (
        "jobs executor items dry-run force verify retry-failed fail-fast "
        "max-failures time-limit memory-limit task-seconds"
    ),
    "Measure": "table plot stats budget",
    "Report": (
        "list print plan strict format lines junit output-file quiet verbose "
        "log-format debug help"
    ),
}
_GROUP_OF = {word: name for name, words in _GROUPS.items() for word in words.split()}
# Groups of options that differ in one command.
_ELSEWHERE = {
    "diff": {"tolerance": "Checks", "angle-tolerance": "Checks"},
    "ik": {"pose": "Time"},
    "preview": {"camera": "Picture", "range": "Picture"},
    "retarget": {"rig": "Solve"},
    "job": {"chunk": "Run"},
}
_PRIM = {"--prim-path": "--source-prim"}
# Options of the version before, by command, and their names now (CLI106).
OLD_OPTIONS = {
    "convert": _PRIM,
    "diff": {
        **_PRIM,
        "--prim-path-a": "--source-prim-a",
        "--prim-path-b": "--source-prim-b",
        "--tol": "--tolerance",
        "--tol-degrees": "--angle-tolerance",
        "--tol-weight": "--weight-tolerance",
    },
    "ik": {"--tol": "--missed", "--tol-degrees": "--missed-degrees"},
    "info": _PRIM,
    "preview": {**_PRIM, "--frames": "--range"},
}
# The most common options of each command.
_COMMON = {
    "bake": "output rig rig-layer fps range plan",
    "batch": "output scene set jobs dry-run items",
    "convert": "reduce units up take source-prim overwrite",
    "diff": "tolerance angle-tolerance take source-prim units format",
    "ik": "targets clip output pose rig-layer missed",
    "info": "take source-prim set units up format",
    "job": "output cut chunk costs fps overwrite",
    "loop": "output repeats first last blend overwrite",
    "clean": "output spikes noise cutoff drift feet",
    "face": "rig output landmarks camera head remap",
    "fill": "output longest template static gaps format",
    "label": "output static subject units format overwrite",
    "solve": "template output rig calibrate static rig-layer",
    "triangulate": "cameras output units up people overwrite",
    "preview": "output range camera sheet watch take",
    "report": "output budget range rig set format",
    "retarget": "rig output map rest rig-layer feet",
    "validate": "select ignore profile strict fix format",
}
_MAX_SHORT = 40  # lines of the short help


class Command(click.Command):
    """A command with short and full help, options grouped."""

    def get_params(self, ctx: click.Context) -> list[click.Parameter]:
        """Return the parameters, with ``-h`` and ``--help`` last."""
        del ctx
        return [*self.params, *_help_options()]

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse arguments; options of the version before are noted (CLI106)."""
        args, renamed = _with_new_names(args, OLD_OPTIONS.get(self.name or "", {}))
        rest = super().parse_args(ctx, args)
        if renamed and ctx.obj is not None:
            from animtool.core.errors import Fault, Severity

            ctx.obj.faults(
                Fault("CLI106", f"{old} is now {new}", severity=Severity.NOTE)
                for old, new in renamed.items()
            )
        return rest

    def collect_usage_pieces(self, ctx: click.Context) -> list[str]:
        """Return the usage, arguments before options."""
        options, *arguments = super().collect_usage_pieces(ctx)
        return [*arguments, options]

    def format_options(
        self, ctx: click.Context, formatter: click.HelpFormatter
    ) -> None:
        """Write all options, by group."""
        groups: dict[str, list[tuple[str, str]]] = {name: [] for name in _GROUPS}
        for option, record in self._records(ctx):
            groups[group_of(self.name or "", option)].append(record)
        for name, records in groups.items():
            if records:
                _section(formatter, name, records)

    def short_help_of(self, ctx: click.Context) -> str:
        """Return the help of ``-h``: usage, common options, examples."""
        formatter = ctx.make_formatter()
        self.format_usage(ctx, formatter)
        about = (self.help or "").strip().split("\n\n")[0]
        formatter.write_paragraph()
        with formatter.indentation():
            formatter.write_text(" ".join(about.split()))
        common = common_options(self.name or "")
        records = {_word(option): record for option, record in self._records(ctx)}
        shown = common or [word for word in records if _GROUP_OF[word] != "Report"]
        firsts = [(records[w][0], _first(records[w][1])) for w in shown if w in records]
        if firsts:
            _section(formatter, "Options", firsts)
        lines = formatter.getvalue().rstrip().splitlines()
        last = f"{ctx.command_path} --help shows all {len(records)} options."
        examples = (self.epilog or "").replace("\b", "").strip().splitlines()
        room = _MAX_SHORT - len(lines) - 3
        kept = examples[: max(room, 2)] if examples else []
        while kept and kept[-1].rstrip().endswith("\\"):
            kept.pop()
        return "\n".join([*lines, "", *kept, *([""] if kept else []), last])

    def _records(
        self, ctx: click.Context
    ) -> Iterable[tuple[click.Option, tuple[str, str]]]:
        """Yield the options with name and help text."""
        for option in self.get_params(ctx):
            record = option.get_help_record(ctx)
            if isinstance(option, click.Option) and record is not None:
                yield option, record


def _with_new_names(
    args: list[str], names: dict[str, str]
) -> tuple[list[str], dict[str, str]]:
    """Return arguments with new names of options, and those that were renamed.

    >>> _with_new_names(["--tol=1", "--", "--tol"], {"--tol": "--missed"})
    (['--missed=1', '--', '--tol'], {'--tol': '--missed'})
    """
    end = args.index("--") if "--" in args else len(args)
    renamed, words = {}, []
    for word in args[:end]:
        option, equals, value = word.partition("=")
        if option in names:
            renamed[option] = names[option]
        words.append(f"{names.get(option, option)}{equals}{value}")
    return [*words, *args[end:]], renamed


def command(*args: Any, **options: Any) -> Callable[[Callable[..., Any]], Command]:
    """Return a decorator that makes a command with grouped help."""
    return click.command(*args, cls=Command, **options)


def write_sections(
    formatter: click.HelpFormatter, sections: Mapping[str, list[tuple[str, str]]]
) -> None:
    """Write commands by group, texts aligned."""
    width = max(len(name) for rows in sections.values() for name, _ in rows)
    for title, rows in sections.items():
        _section(formatter, title, [(name.ljust(width), text) for name, text in rows])


def group_of(command: str, option: click.Option) -> str:
    """Return the heading of an option; KeyError if it has none."""
    word = _word(option)
    return _ELSEWHERE.get(command, {}).get(word) or _GROUP_OF[word]


def common_options(command: str) -> list[str]:
    """Return the options in a command's short help; empty for all but reports."""
    return _COMMON.get(command, "").split()


def _word(option: click.Option) -> str:
    return max(option.opts, key=len).removeprefix("--").removeprefix("-")


def _first(text: str) -> str:
    """Return the first sentence of a text, without its default."""
    text = text.partition("  [")[0].partition(". ")[0]
    return f"{text.rstrip('.')}."


def _section(
    formatter: click.HelpFormatter, title: str, records: list[tuple[str, str]]
) -> None:
    # Click strips colors without a terminal.
    plain = bool(os.environ.get("NO_COLOR"))
    with formatter.section(title if plain else click.style(title, bold=True)):
        formatter.write_dl(records)


def _help_options() -> list[click.Parameter]:
    """Return ``-h`` and ``--help``."""

    def full_help(ctx: click.Context, _: click.Parameter, asked: bool) -> None:
        if asked and not ctx.resilient_parsing:
            click.echo(ctx.get_help(), color=ctx.color)
            ctx.exit()

    def short(ctx: click.Context, _: click.Parameter, asked: bool) -> None:
        if asked and not ctx.resilient_parsing:
            command = ctx.command
            text = command.short_help_of(ctx) if isinstance(command, Command) else ""
            click.echo(text or ctx.get_help(), color=ctx.color)
            ctx.exit()

    flags: dict[str, Any] = {
        "is_flag": True,
        "expose_value": False,
        "is_eager": True,
    }
    return [
        click.Option(["-h"], callback=short, hidden=True, **flags),
        click.Option(
            ["--help"],
            callback=full_help,
            help="Show this message; -h shows the usual options.",
            **flags,
        ),
    ]


class LazyGroup(click.Group):
    """A click group that imports a command's module when it is called.

    Attributes:
        table: By command name, its ``module:object`` and its one-line help.
        sections: Names of the commands below each heading of the help.
        other_names: What users of other tools type, and the command for it.
        takes_files: Command to suggest for a file in place of a command.
    """

    def __init__(
        self,
        *args: Any,
        table: Mapping[str, tuple[str, str]],
        sections: Mapping[str, tuple[str, ...]] | None = None,
        other_names: Mapping[str, str] | None = None,
        takes_files: str = "",
        **options: Any,
    ) -> None:
        super().__init__(*args, **options)
        self.table = table
        self.sections = sections or {"Commands": tuple(sorted(table))}
        self.other_names = other_names or {}
        self.takes_files = takes_files

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

            if self.takes_files and "." in args[0]:
                hint = f"{ctx.command_path} {self.takes_files} {args[0]}"
                ctx.fail(f"{args[0]!r} is not a command; did you mean {hint!r}?")
            near = get_close_matches(args[0], self.table, 1)
            meant = self.other_names.get(args[0]) or next(iter(near), "")
            hint = f"; did you mean {meant!r}?" if meant else ""
            hint = hint or f"; {ctx.command_path} --help lists the commands"
            ctx.fail(f"unknown command {args[0]!r}{hint}")
        return super().resolve_command(ctx, args)
