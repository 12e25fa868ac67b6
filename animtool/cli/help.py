"""Help: ``-h`` shows the common options, ``--help`` all of them in groups."""

from __future__ import annotations

import importlib
import os
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import click

# Headings of the help, in this order, with their options.
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
    "Options": "",
    "Picture": ("size sheet light caption numbers show turntable findings open watch"),
    "Checks": (
        "select ignore severity profile exit-zero fix diff warn-above weight-tolerance "
        "missed missed-degrees"
    ),
    "Output": (
        "output as split rig-layer prim-path placement force-fit bones to-units to-up "
        "root-motion sparse keep-curves reduce reduce-at physics write-map "
        "write-rig write-template keep-stopped until name overwrite skip-existing check"
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
_OTHER_GROUP = "Options"  # of options that are not listed
_GROUP_BY_OPTION = {
    word: name for name, words in _GROUPS.items() for word in words.split()
}
# Options with another heading in one command.
_GROUPS_BY_COMMAND = {
    "diff": {"tolerance": "Checks", "angle-tolerance": "Checks"},
    "ik": {"pose": "Time"},
    "preview": {"camera": "Picture", "range": "Picture"},
    "retarget": {"rig": "Solve"},
    "job": {"chunk": "Run"},
}
_RENAMED_PRIM = {"--prim-path": "--source-prim"}
# Renamed options of the previous version by command, with their new names (CLI106).
OLD_OPTIONS = {
    "convert": _RENAMED_PRIM,
    "diff": {
        **_RENAMED_PRIM,
        "--prim-path-a": "--source-prim-a",
        "--prim-path-b": "--source-prim-b",
        "--tol": "--tolerance",
        "--tol-degrees": "--angle-tolerance",
        "--tol-weight": "--weight-tolerance",
    },
    "ik": {"--tol": "--missed", "--tol-degrees": "--missed-degrees"},
    "info": _RENAMED_PRIM,
    "preview": {**_RENAMED_PRIM, "--frames": "--range"},
}
# The most common options of each command.
_COMMON_OPTIONS = {
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
_MAX_SHORT_HELP_LINES = 40
# Where a context keeps the arguments of its command, before they are parsed.
ARGUMENTS_KEY = "animtool.arguments"


class Command(click.Command):
    """A command with a short and a full help, and options in groups."""

    def get_params(self, ctx: click.Context) -> list[click.Parameter]:
        """Return the parameters of the command, with ``-h`` and ``--help`` last."""
        del ctx
        return [*self.params, *_help_options()]

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse arguments; warn about options of the previous version (CLI106)."""
        args, old_options = _with_new_names(args, OLD_OPTIONS.get(self.name or "", {}))
        ctx.meta[ARGUMENTS_KEY] = tuple(args)
        remaining_args = super().parse_args(ctx, args)
        if old_options and ctx.obj is not None:
            from animtool.core.errors import Fault, Severity

            ctx.obj.faults(
                Fault("CLI106", f"{old} is now {new}", severity=Severity.NOTE)
                for old, new in old_options.items()
            )
        return remaining_args

    def collect_usage_pieces(self, ctx: click.Context) -> list[str]:
        """Return the parts of the usage line, with arguments before options."""
        options, *arguments = super().collect_usage_pieces(ctx)
        return [*arguments, options]

    def format_options(
        self, ctx: click.Context, formatter: click.HelpFormatter
    ) -> None:
        """Write the help of all options in groups."""
        groups: dict[str, list[tuple[str, str]]] = {name: [] for name in _GROUPS}
        for option, record in self._help_records(ctx):
            groups[heading_of(self.name or "", option)].append(record)
        for name, records in groups.items():
            if records:
                _write_section(formatter, name, records)

    def short_help_of(self, ctx: click.Context) -> str:
        """Return the text of ``-h``: usage, common options and examples."""
        formatter = ctx.make_formatter()
        self.format_usage(ctx, formatter)
        first_paragraph = (self.help or "").strip().split("\n\n")[0]
        formatter.write_paragraph()
        with formatter.indentation():
            formatter.write_text(" ".join(first_paragraph.split()))
        records = {_option_word(option): r for option, r in self._help_records(ctx)}
        shown_options = common_options(self.name or "") or [
            word for word in records if _GROUP_BY_OPTION.get(word) != "Report"
        ]
        option_rows = [
            (records[word][0], _first_sentence(records[word][1]))
            for word in shown_options
            if word in records
        ]
        if option_rows:
            _write_section(formatter, "Options", option_rows)
        help_lines = formatter.getvalue().rstrip().splitlines()
        last_line = f"{ctx.command_path} --help shows all {len(records)} options."
        examples = (self.epilog or "").replace("\b", "").strip().splitlines()
        free_lines = _MAX_SHORT_HELP_LINES - len(help_lines) - 3
        shown_examples = examples[: max(free_lines, 2)] if examples else []
        while shown_examples and shown_examples[-1].rstrip().endswith("\\"):
            shown_examples.pop()
        if shown_examples:
            shown_examples.append("")
        return "\n".join([*help_lines, "", *shown_examples, last_line])

    def _help_records(
        self, ctx: click.Context
    ) -> Iterable[tuple[click.Option, tuple[str, str]]]:
        """Yield each option that has a help text, with its name and that text."""
        for option in self.get_params(ctx):
            record = option.get_help_record(ctx)
            if isinstance(option, click.Option) and record is not None:
                yield option, record


def _with_new_names(
    args: list[str], new_names: dict[str, str]
) -> tuple[list[str], dict[str, str]]:
    """Return arguments with old option names replaced, and the replaced names.

    >>> _with_new_names(["--tol=1", "--", "--tol"], {"--tol": "--missed"})
    (['--missed=1', '--', '--tol'], {'--tol': '--missed'})
    """
    end_of_options = args.index("--") if "--" in args else len(args)
    replaced_options, new_args = {}, []
    for argument in args[:end_of_options]:
        option, equals, value = argument.partition("=")
        if option in new_names:
            replaced_options[option] = new_names[option]
        new_args.append(f"{new_names.get(option, option)}{equals}{value}")
    return [*new_args, *args[end_of_options:]], replaced_options


def command(*args: Any, **options: Any) -> Callable[[Callable[..., Any]], Command]:
    """Return a decorator that makes a function a command with grouped help."""
    return click.command(*args, cls=Command, **options)


def write_sections(
    formatter: click.HelpFormatter, sections: Mapping[str, list[tuple[str, str]]]
) -> None:
    """Write commands in groups, with aligned texts."""
    width = max(len(name) for records in sections.values() for name, _ in records)
    for title, records in sections.items():
        aligned_records = [(name.ljust(width), text) for name, text in records]
        _write_section(formatter, title, aligned_records)


def heading_of(command: str, option: click.Option) -> str:
    """Return the heading of the group that an option belongs to."""
    word = _option_word(option)
    group = _GROUPS_BY_COMMAND.get(command, {}).get(word)
    return group or _GROUP_BY_OPTION.get(word, _OTHER_GROUP)


def common_options(command: str) -> list[str]:
    """Return the options that ``-h`` lists; empty for all but those of ``Report``."""
    return _COMMON_OPTIONS.get(command, "").split()


def _option_word(option: click.Option) -> str:
    return max(option.opts, key=len).removeprefix("--").removeprefix("-")


def _first_sentence(text: str) -> str:
    """Return the first sentence of a text, without the default value."""
    text = text.partition("  [")[0].partition(". ")[0]
    return f"{text.rstrip('.')}."


def _write_section(
    formatter: click.HelpFormatter, title: str, records: list[tuple[str, str]]
) -> None:
    # Click strips colors without a terminal.
    has_no_color = bool(os.environ.get("NO_COLOR"))
    with formatter.section(title if has_no_color else click.style(title, bold=True)):
        formatter.write_dl(records)


def _help_options() -> list[click.Parameter]:
    """Return the hidden option ``-h`` and the option ``--help``."""

    def short_help(ctx: click.Context) -> str:
        command = ctx.command
        text = command.short_help_of(ctx) if isinstance(command, Command) else ""
        return text or ctx.get_help()

    help_text = "Show this message; -h shows the usual options."
    return [
        _help_option("-h", short_help, hidden=True),
        _help_option("--help", click.Context.get_help, help=help_text),
    ]


def _help_option(
    name: str, help_of: Callable[[click.Context], str], **settings: Any
) -> click.Option:
    def print_help(ctx: click.Context, _: click.Parameter, is_requested: bool) -> None:
        if is_requested and not ctx.resilient_parsing:
            click.echo(help_of(ctx), color=ctx.color)
            ctx.exit()

    flags: dict[str, Any] = {"is_flag": True, "expose_value": False, "is_eager": True}
    return click.Option([name], callback=print_help, **flags, **settings)


class LazyGroup(click.Group):
    """A click group that imports a command's module when it is called.

    Attributes:
        sections: Below each heading of the help, its commands: ``module:object`` and
            a one-line help by name.
        entries: All commands.
        other_names: What users of other tools type, and the command for it.
        file_command: Command to suggest for a file in place of a command.
    """

    def __init__(
        self,
        *args: Any,
        sections: Mapping[str, Mapping[str, tuple[str, str]]],
        other_names: Mapping[str, str] | None = None,
        file_command: str = "",
        **options: Any,
    ) -> None:
        super().__init__(*args, **options)
        self.sections = sections
        self.entries = {
            name: entry
            for section in sections.values()
            for name, entry in section.items()
        }
        self.other_names = other_names or {}
        self.file_command = file_command

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the names of all commands."""
        del ctx
        return sorted(self.entries)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import the module of a command and return the command."""
        del ctx
        if cmd_name not in self.entries:
            return None
        module, _, name = self.entries[cmd_name][0].partition(":")
        command: click.Command = getattr(importlib.import_module(module), name)
        return command

    def format_commands(
        self, ctx: click.Context, formatter: click.HelpFormatter
    ) -> None:
        """Write the list of commands without importing them."""
        del ctx
        sections = {
            title: [(name, text) for name, (_, text) in section.items()]
            for title, section in self.sections.items()
        }
        write_sections(formatter, sections)

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Return a command, also for ``help COMMAND``; suggest one if it is unknown."""
        if args[:1] == ["help"] and "help" not in self.entries:
            args = [*args[1:2], "--help"]
            if len(args) == 1:
                click.echo(ctx.get_help(), color=ctx.color)
                ctx.exit()
        if args and args[0] not in self.entries and not args[0].startswith("-"):
            from difflib import get_close_matches

            if self.file_command and "." in args[0]:
                hint = f"{ctx.command_path} {self.file_command} {args[0]}"
                ctx.fail(f"{args[0]!r} is not a command; did you mean {hint!r}?")
            close_names = get_close_matches(args[0], self.entries, 1)
            suggestion = self.other_names.get(args[0]) or next(iter(close_names), "")
            hint = f"; did you mean {suggestion!r}?" if suggestion else ""
            hint = hint or f"; {ctx.command_path} --help lists the commands"
            ctx.fail(f"unknown command {args[0]!r}{hint}")
        return super().resolve_command(ctx, args)
