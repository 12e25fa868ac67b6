"""Output of a command: results go to stdout, everything else to stderr."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import field, replace
from typing import TYPE_CHECKING, cast

import click

from animtool.core.arguments import (
    Argument,
    ArgumentNamer,
    file_key,
    flag,
    name_arguments,
)
from animtool.core.errors import Fault, Severity
from animtool.core.plugins import load_object
from animtool.core.process.supervisor import record_output
from animtool.core.quantities import escaped, printable_json
from animtool.core.record import dataclass
from animtool.core.values import plain_value

if TYPE_CHECKING:
    from animtool.report.text import Template


# Option names of a source in commands whose other options have the plain name.
SOURCE_NAMES = {"fps": "source_fps", "prim_path": "source_prim", "unit": "units"}


def flag_of(argument: Argument) -> str:
    """Return an argument as a flag of the same name.

    >>> flag_of(Argument("rig_layer")), flag_of(Argument("normals", "false"))
    ('--rig-layer', '--no-normals')
    """
    word = argument.field.replace("_", "-")
    if argument.boolean_value is not None:
        return flag(word if argument.boolean_value else f"no-{word}")
    return flag(word, argument.value or "")


@dataclass(frozen=True, slots=True)
class FlagNamer:
    """Replaces names of Python arguments in messages by the flags of a command."""

    command: click.Command

    def __call__(self, argument: Argument) -> str | None:
        """Return the flag of an argument; None if the command has none."""
        value = argument.value or ""
        is_form = argument.field == "form"
        if is_form and _find_option(self.command, (value,)) is not None:
            return flag(value)  # --split
        option = _find_option(self.command, _option_names(argument))
        if option is None:
            return None
        if argument.boolean_value is False and option.secondary_opts:
            return option.secondary_opts[0]
        if argument.boolean_value is not None:
            choice = option.type
            value = str(choice.choices[-1]) if isinstance(choice, click.Choice) else ""
        return f"{option.opts[0]} {value}".rstrip()

    def name_elsewhere(self, argument: Argument) -> str:
        """Return the name of an argument that this command lacks.

        It is the flag of `animtool bake`, such as ``bake --up Z``, else a key of files.
        """
        # Loaded by name: its module imports this one.
        bake = cast(click.Command, load_object("animtool.cli.bake:bake"))
        flag_name = FlagNamer(bake)(argument)
        return file_key(argument) if flag_name is None else f"bake {flag_name}"


def _option_names(argument: Argument) -> tuple[str, ...]:
    """Return the possible option names of an argument, the most common one first."""
    field = argument.field
    source_name = SOURCE_NAMES.get(field)
    if source_name is None or not argument.name.startswith("source."):
        return (field,)
    # Without `source.` the name is the output's; paths may be either.
    return (source_name,) if field == "fps" else (source_name, field)


def _find_option(command: click.Command, names: tuple[str, ...]) -> click.Option | None:
    """Return the first of some named options that a command has, or None."""
    options = [param for param in command.params if isinstance(param, click.Option)]
    for name in names:
        for option in options:
            if option.name == name or f"--{name.replace('_', '-')}" in option.opts:
                return option
    return None


_COLORS = {Severity.ERROR: "31", Severity.WARNING: "33", Severity.NOTE: "36"}


@dataclass(slots=True)
class Console:
    """Writes results to stdout, and faults, notes and progress to stderr."""

    verbosity: int = 0  # -1 for errors only, 0 by default, 1 with notes and timings
    logs_json: bool = False  # write each line on stderr as a JSON object
    debug: bool = False  # whether Python tracebacks are shown
    namer: ArgumentNamer = flag_of  # names arguments by flags of the command
    context: click.Context | None = None  # of the command
    # Warnings that were written early, and are not repeated.
    early_faults: set[Fault] = field(default_factory=set)

    def result(self, *lines: str) -> None:
        """Write result lines to stdout, control characters escaped."""
        escaped_lines = (escaped(name_arguments(line, self.namer)) for line in lines)
        sys.stdout.write("".join(f"{line}\n" for line in escaped_lines))
        record_output()

    def result_json(self, value: object, *, is_one_line: bool = False) -> None:
        """Write a record or plain values to stdout as JSON, or as one line of ASCII."""
        indent = None if is_one_line else 2
        value = self._with_flags(plain_value(value))
        self.document(printable_json(value, indent=indent, is_ascii_only=is_one_line))
        sys.stdout.flush()

    def document(self, text: str) -> None:
        """Write a document to stdout without escapes."""
        sys.stdout.write(text if text.endswith("\n") else text + "\n")
        record_output()

    def say(self, text: str) -> None:
        """Write a line of the summary to stderr, unless quiet."""
        if self.verbosity >= 0:
            self._write_line("info", text)

    def detail(self, text: str) -> None:
        """Write a line to stderr, if verbose."""
        if self.verbosity > 0:
            self._write_line("debug", text)

    def warn_early(self, faults: Iterable[Fault]) -> None:
        """Write warnings before long work; they are not repeated at its end."""
        warnings = [f for f in faults if f.severity is Severity.WARNING]
        if self.verbosity >= 0:
            self.faults(warnings)
            self.early_faults.update(warnings)

    def faults(self, faults: Iterable[Fault], *, is_fatal: bool = False) -> None:
        """Write each distinct fault to stderr; when quiet, only errors.

        An error or warning at a column is followed by its source line and a caret.
        """
        sources = None
        for raw_fault in dict.fromkeys(faults):
            if raw_fault in self.early_faults:
                continue
            fault = raw_fault.with_argument_names(self.namer)
            if is_fatal or self.verbosity >= 0 or fault.severity is Severity.ERROR:
                code = escaped(fault.code)
                colored_code = self._colored(code, _COLORS[fault.severity])
                log_entry = {"level": str(fault.severity), **plain_value(fault)}
                shown_fault = fault
                if fault.brief and self.verbosity <= 0:
                    shown_fault = replace(fault, message=fault.brief)
                text = str(shown_fault).replace(code, colored_code, 1)
                has_line = fault.column and fault.severity is not Severity.NOTE
                if has_line and not self.logs_json:
                    from animtool.core import source_lines

                    sources = sources or source_lines.SourceLineCache()
                    lines = map(escaped, source_lines.excerpt_lines(fault, sources))
                    text = "\n".join([text, *lines])
                self._write(log_entry, text)

    def report(
        self,
        report_format: str,
        record: object,
        template: Template,
        notices: Iterable[Fault] = (),
    ) -> None:
        """Write notices, and a report as JSON to stdout or as lines.

        The format is ``json`` or ``text``. Result lines of the template go to stdout,
        other lines to stderr.
        """
        self.faults(notices)
        if report_format == "json":
            self.result_json(record)
            return
        lines = template.text(record, all_names=self.verbosity > 0)
        if template.is_result:
            self.result(*lines)
        else:
            self.lines(lines)
        if self.verbosity > 0:
            self.details(template.detail_lines(record))

    def details(self, lines: Iterable[str]) -> None:
        """Write lines to stderr, if verbose."""
        for line in lines:
            self.detail(line)

    def lines(self, lines: Iterable[str]) -> None:
        """Write lines of the summary to stderr, unless quiet."""
        for line in lines:
            self.say(line)

    def error(self, message: str, *details: str) -> None:
        """Write an error without a code to stderr, with detail lines."""
        label = self._colored("error", _COLORS[Severity.ERROR])
        texts = [name_arguments(text, self.namer) for text in (message, *details)]
        lines = "\n".join(map(escaped, texts))
        log_entry: dict[str, object] = {"level": "error", "message": "\n".join(texts)}
        self._write(log_entry, f"{label}: {lines}")

    def is_live(self) -> bool:
        """Return whether stderr is a terminal that can show live updates."""
        return self.verbosity >= 0 and not self.logs_json and sys.stderr.isatty()

    @contextmanager
    def progress(
        self, label: str, *, is_stdout: bool = False
    ) -> Iterator[Callable[[float], None] | None]:
        """Yield a progress callback, or None if there is no terminal."""
        if not self.is_live() or (is_stdout and sys.stdout.isatty()):
            yield None
            return
        from rich.console import Console as RichConsole
        from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

        bar = Progress(
            TextColumn("{task.description}", markup=False),
            BarColumn(),
            TextColumn("{task.percentage:3.0f} %"),
            TimeRemainingColumn(),
            console=RichConsole(stderr=True),
            transient=True,
        )
        task = bar.add_task(escaped(label), total=1.0)

        def show(fraction: float) -> None:
            # Delayed start: commands that fail at once show no bar.
            if not bar.live.is_started:
                bar.start()
            bar.update(task, completed=fraction)

        try:
            yield show
        finally:
            bar.stop()

    def _with_flags(self, value: object) -> object:
        """Return plain values whose texts name arguments by flags."""
        if isinstance(value, str):
            return name_arguments(value, self.namer)
        if isinstance(value, Mapping):
            return {key: self._with_flags(element) for key, element in value.items()}
        if isinstance(value, list | tuple):
            return [self._with_flags(element) for element in value]
        return value

    def _write_line(self, level: str, text: str) -> None:
        text = name_arguments(text, self.namer)
        self._write({"level": level, "message": text}, escaped(text))

    def _write(self, log_entry: dict[str, object], text: str) -> None:
        """Write text to stderr, or an entry as JSON if the log is JSON."""
        sys.stderr.write((printable_json(log_entry) if self.logs_json else text) + "\n")
        record_output()

    def _colored(self, text: str, color_code: str) -> str:
        """Return text in a color, by NO_COLOR, FORCE_COLOR and the kind of stderr."""
        is_colored = bool(os.environ.get("FORCE_COLOR")) or sys.stderr.isatty()
        if os.environ.get("NO_COLOR") or not is_colored:
            return text
        return f"\x1b[{color_code}m{text}\x1b[0m"
