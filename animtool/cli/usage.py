"""Usage errors that suggest the command line that was likely meant."""

from __future__ import annotations

import glob
import re
import shlex
from collections.abc import Iterator
from dataclasses import replace
from difflib import get_close_matches
from pathlib import Path

import click
from click.core import ParameterSource

from animtool.cli.help import ARGUMENTS_KEY, LazyGroup
from animtool.cli.outputs import is_missing_input
from animtool.core.errors import Fault
from animtool.documents.other_words import VALUE_ALIASES

# Options of other commands and tools, and ours.
OTHER_OPTIONS = {
    "--out": ("--output",),
    "--out-file": ("--output",),
    "--rig": ("--to",),
    "--anim": ("--take",),
    "--animation": ("--take",),
    "--count": ("--repeats",),
    "--repeat": ("--repeats",),
    "--target": ("--to", "--targets"),
    "--to": ("--rig",),
    "--prim": ("--source-prim",),
    "--unit": ("--units",),
    "--scale": ("--units",),
    "--up-axis": ("--up",),
    "--rate": ("--fps",),
    "--frame-rate": ("--fps",),
    "--tolerance": ("--reduce",),
    "--threads": ("--jobs",),
    "--workers": ("--jobs",),
    "--force": ("--overwrite",),
    "--dry-run": ("--plan", "--diff"),
    "--plan": ("--dry-run", "--diff"),
    "--json": ("--format",),
    "--variable": ("--set",),
    "--code": ("--select",),
}
# Names for a range of frames or its ends.
_FRAME_RANGE_NAMES = {
    *("-s", "-e"),
    "--range",
    "--frames",
    "--frame-range",
    *(f"--{end}{suffix}" for end in ("start", "end") for suffix in ("", "-frame")),
    *(f"--{end}{suffix}" for end in ("first", "last") for suffix in ("", "-frame")),
}
# Options of commands that read a clip, whose file names them.
_FILES_NAMED_IN_CLIPS = {"--rig"}
# Similarity from which an option is suggested, or if another command has the name.
MIN_SIMILARITY, HIGH_SIMILARITY = 0.75, 0.9
# Names of a command's first argument in other tools.
_FIRST_ARGUMENT_NAMES = {"input", "in", "source", "src", "file", "i", "path"}
# Kinds of files by their names, and the option that takes one.
_OPTION_BY_FILE_KIND = {
    "targets": "--targets",
    "rig": "--rig",
    "scene": "--scene",
    "map": "--map",
    "cameras": "--cameras",
    "markers": "--template",
    "remap": "--remap",
}
# Commands to suggest for an option: the first of these that has it.
_SUGGESTED_COMMANDS = ("bake", "retarget", "ik", "batch", "validate", "preview", "info")
_UNITS = {"mm", "cm", "m", "in", "deg", "rad", "s", "ms"}
_NUMBER = re.compile(r"-?[\d.]+")
# Values of several numbers by their placeholder in help.
_EXAMPLE_BY_METAVAR = {
    "A-B[xN]": "1-24",
    "A-B[xN]|A,B,...": "1-24",
    "OFFSETS": "-.25,0,.25",
}
# Text options that may have the path of a file.
_OPTIONS_OF_PATHS = {"output", "profile"}
_EXPLICIT_SOURCES = {ParameterSource.COMMANDLINE, ParameterSource.ENVIRONMENT}
_CHOICE_MESSAGE = re.compile(r": '([^']*)' is not one of ('.*')\.")
_EXTRA_ARGUMENTS = re.compile(r"unexpected extra arguments? \((.*)\)")


def with_suggestion(error: click.ClickException) -> click.ClickException:
    """Return a usage error that suggests the option, argument or value likely meant."""
    context = getattr(error, "ctx", None)
    if context is None:
        return error
    if isinstance(error, click.NoSuchOption):
        hint = next(_option_hints(error.option_name, context), None)
        hint = hint or f"{context.command_path} -h lists the options"
        text = f"No such option {error.option_name!r}; {hint}"
    elif extra_match := _EXTRA_ARGUMENTS.search(error.message):
        extra_argument = extra_match[1].split()[0]
        hint = _argument_hint(extra_argument, context)
        hint = hint or f"{context.command_path} -h shows what it takes"
        if len(_command_options(context.command)) == len(context.command.params):
            hint = f"{context.command_path} takes options only"
        text = f"Unexpected argument {extra_argument!r}; {hint}"
    elif isinstance(error, click.MissingParameter) and (
        misplaced_text := _misplaced_argument(error, context)
    ):
        text = misplaced_text
    elif isinstance(error, click.MissingParameter):
        text = _missing_text(error, context)
    elif choice_match := _CHOICE_MESSAGE.search(error.format_message()):
        names = re.findall(r"'([^']*)'", choice_match[2])
        param = getattr(error, "param", None)
        if choice_match[1].startswith("-") and param is not None:
            flag = param.opts[-1]
            text = f"Option {flag!r} needs a value: {' or '.join(names)}."
            return click.UsageError(text, context)
        meant_value = VALUE_ALIASES.get(choice_match[1].lower())
        if meant_value not in names:
            meant_value = next(iter(get_close_matches(choice_match[1], names, 1)), None)
        if meant_value is None:
            return error
        text = f"{error.format_message().rstrip('.')}; did you mean {meant_value!r}?"
    else:
        return error
    ends_sentence = text.endswith("?") or isinstance(error, click.MissingParameter)
    return click.UsageError(text if ends_sentence else f"{text}.", context)


def _missing_text(error: click.MissingParameter, context: click.Context) -> str:
    """Return what a missing argument or option takes, with an example if it has one."""
    param = error.param
    text = " ".join(error.format_message().rstrip(".").split())
    if isinstance(param, click.Option) and param.help:
        text += f": {re.split('[.;(] | [(]', param.help)[0].rstrip('.')}"
    lines = (context.command.epilog or "").splitlines()
    example = next((line.strip() for line in lines if "animtool " in line), None)
    if isinstance(param, click.Argument) and (swapped := _option_with_file(context)):
        flag, file = swapped
        return f"{text}; {flag} has the file {file}: give {flag} its own value"
    return f"{text}; for example {example}" if example else text


def _misplaced_argument(
    error: click.MissingParameter, context: click.Context
) -> str | None:
    """Return a hint if an argument was likely meant for a missing option, else None."""
    param = error.param
    arguments = context.meta.get(ARGUMENTS_KEY, ())
    if not isinstance(param, click.Option) or not arguments:
        return None
    # What the command has no argument for.
    parser = context.command.make_parser(context)
    _, extra_arguments, _ = parser.parse_args([*arguments])
    if not extra_arguments:
        return None
    flag, argument = param.opts[-1], extra_arguments[0]
    return f"Unexpected argument {argument!r}; write {flag} {argument}"


def with_option(fault: Fault, context: click.Context) -> Fault:
    """Return a fault located at the option that sets its field or names its file."""
    if fault.where and not fault.lines:
        for option in _command_options(context.command):
            if option.name == fault.where or f"--{fault.where}" in option.opts:
                return replace(fault, where=option.opts[-1])
    if not fault.code.startswith("IO") or fault.where or fault.path is None:
        return fault
    if _NUMBER.fullmatch(fault.path):
        return replace(fault, hint=_number_hint(context, fault.path) or fault.hint)
    swapped_option = _option_with_file(context)
    if swapped_option is not None and not Path(fault.path).exists():
        flag, file = swapped_option
        message = f"{fault.message}, and {flag} is the file {file}"
        command = _swapped_command(context, fault.path, file)
        return replace(fault, message=message, hint=f"write {command}")
    for option in _command_options(context.command):
        value = context.params.get(str(option.name))
        if isinstance(value, Path) and str(value) == fault.path:
            words = context.meta.get(ARGUMENTS_KEY, ())
            flag = next((f for f in option.opts if f in words), option.opts[0])
            hint = fault.hint or (None if value.suffix else "it takes a file")
            likely_file = (
                None if value.suffix else _file_of_name(context, option, value)
            )
            if likely_file is not None:
                hint = f"write {flag} {likely_file}"
            return replace(fault, where=flag, hint=hint)
    return fault


def _file_of_name(
    context: click.Context, option: click.Parameter, name: Path
) -> Path | None:
    """Return the file that a bare name likely means, such as a rig of the sample."""
    inputs = [v for v in context.params.values() if isinstance(v, Path) and v != name]
    folders = [Path(), *(path.parent for path in inputs if path.is_file())]
    folders += [folder.parent for folder in folders[1:]]
    file_name = f"{glob.escape(name.name)}.{option.name}.yaml"
    files = (
        file
        for folder in folders
        for pattern in (file_name, f"*/{file_name}")
        for file in sorted(folder.glob(pattern))
    )
    return next(files, None)


def _option_with_file(context: click.Context) -> tuple[str, str] | None:
    """Return the flag and value of a text option that has the path of a file."""
    for option in _command_options(context.command):
        value = context.params.get(str(option.name))
        is_text = option.type is click.STRING and isinstance(value, str)
        is_text &= option.name not in _OPTIONS_OF_PATHS
        source = context.get_parameter_source(str(option.name))
        if is_text and source in _EXPLICIT_SOURCES and Path(str(value)).is_file():
            return option.opts[0], str(value)
    return None


def _swapped_command(context: click.Context, first: str, second: str) -> str:
    """Return the command line with two of its words swapped."""
    other = {first: second, second: first}
    words = []
    for word in context.meta.get(ARGUMENTS_KEY, ()):
        flag, sign, value = word.partition("=")
        is_flag = word.startswith("-") and sign
        words.append(
            f"{flag}={other.get(value, value)}" if is_flag else other.get(word, word)
        )
    return f"{context.command_path} {shlex.join(words)}"


def _number_hint(context: click.Context, number: str) -> str | None:
    """Return a hint if numbers after an option were split at a space, else None."""
    for option in _command_options(context.command):
        name = str(option.name)
        example = _EXAMPLE_BY_METAVAR.get(str(option.metavar))
        if example and context.get_parameter_source(name) in _EXPLICIT_SOURCES:
            flag = option.opts[-1]
            words = [*context.meta.get(ARGUMENTS_KEY, ())]
            k = words.index(number) if number in words else 0
            if k > 1 and words[k - 2] in option.opts:
                separator = "," if "," in example else "-"
                example = f"{words[k - 1]}{separator}{number}"
            return f"a value of {flag} has no spaces: write {flag} {example}"
    return None


def _option_hints(name: str, context: click.Context) -> Iterator[str]:
    """Yield hints for an unknown option, the best hint first."""
    command, command_path = context.command, context.command_path
    bare_name = name.lstrip("-")
    if isinstance(command, LazyGroup) and bare_name in command.entries:
        yield f"write {command_path} {bare_name}"
    output = _argument_named("output", command) if bare_name == "to" else None
    if output is not None:
        yield f"{output} is an argument: {command_path} SOURCE {output}"
    flags = [flag for param in _command_options(command) for flag in param.opts]
    # A key of files and Python, such as rest_frame, may have another name here.
    key_flags = [
        param.opts[-1]
        for param in _command_options(command)
        if param.name == bare_name.replace("-", "_")
    ]
    equivalent_flags = [*OTHER_OPTIONS.get(name, ()), *key_flags]
    equivalent_flags = [flag for flag in equivalent_flags if flag in flags]
    if equivalent_flags:
        yield f"did you mean {equivalent_flags[0]!r}?"
    if name in _FRAME_RANGE_NAMES:
        if "--range" in flags:
            yield f"did you mean '--range'{', such as 1-24' * (len(name) == 2)}?"
        elif {"--first", "--last"} <= {*flags}:
            yield f"{command_path} takes a range of frames as --first and --last"
    if command.name == "validate" and name in _FILES_NAMED_IN_CLIPS:
        yield f"a clip is checked on the rig that it names; leave out {name}"
    argument = _argument_named(bare_name, command)
    if argument is not None:
        yield f"{argument} is an argument: {command_path} {argument}"
    owning_command = next(_commands_with_option(name, context), None)
    cutoff = HIGH_SIMILARITY if owning_command else MIN_SIMILARITY
    close_matches = get_close_matches(name, flags, 1, cutoff)
    if close_matches:
        yield f"did you mean {close_matches[0]!r}?"
    if bare_name in {"o", "output"}:
        yield "the result goes to stdout; add > FILE"
    if owning_command is not None:
        yield f"{owning_command} has it, {command_path} does not"
    if "--set" in flags and name.startswith("--"):
        yield f"to set a variable of a scene, write --set {bare_name}=VALUE"


def _commands_with_option(name: str, context: click.Context) -> Iterator[str]:
    """Yield the commands that have an option, the common commands first."""
    root, group = context.find_root(), context.parent
    paths = [(path, command) for path, command in _commands_below(root.command, root)]
    if group is not None and group.info_name is not None:
        # The commands of the same group first.
        paths.sort(key=lambda entry: not entry[0].startswith(f"{group.info_name} "))
    for path, command in paths:
        if any(name in param.opts for param in _command_options(command)):
            yield f"{root.command_path} {path}"


def _commands_below(
    group: click.Command, context: click.Context
) -> Iterator[tuple[str, click.Command]]:
    """Yield the name and command of each command, those of nested groups last."""
    if not isinstance(group, LazyGroup):
        return
    nested_groups = {}
    suggested_names = [n for n in _SUGGESTED_COMMANDS if n in group.entries]
    for name in dict.fromkeys((*suggested_names, *group.entries)):
        command = group.get_command(context, name)
        if isinstance(command, LazyGroup):
            nested_groups[name] = command
        elif command is not None:
            yield name, command
    for name, nested_group in nested_groups.items():
        for path, command in _commands_below(nested_group, context):
            yield f"{name} {path}", command


def _command_options(command: click.Command) -> list[click.Option]:
    return [param for param in command.params if isinstance(param, click.Option)]


def _argument_named(name: str, command: click.Command) -> str | None:
    """Return the placeholder of the argument with the name of an option, else None."""
    arguments = [param for param in command.params if isinstance(param, click.Argument)]
    for i, argument in enumerate(arguments):
        placeholder = (argument.metavar or argument.human_readable_name).rstrip(".")
        words = re.findall(r"[a-z]+", placeholder.lower())
        is_first_name = i == 0 and name in _FIRST_ARGUMENT_NAMES
        if is_first_name or name in {str(argument.name).lower(), *words}:
            return placeholder
    return None


def _argument_hint(text: str, context: click.Context) -> str | None:
    """Return a hint for an unexpected argument of a command."""
    if text in _UNITS:
        return f"write number and unit in one word, such as 1{text}"
    flags = {flag for param in _command_options(context.command) for flag in param.opts}
    path = Path(text)
    for kind, flag in _OPTION_BY_FILE_KIND.items():
        if f".{kind}" in path.suffixes and flag in flags:
            return f"write {flag} {text}"
    if "--clip" in flags and path.suffix and path.exists():
        return f"to start from it, write --clip {text}"
    source = context.params.get("source")
    is_missing = isinstance(source, Path) and is_missing_input(source)
    if "--output" in flags and is_missing and path.exists():
        hint = f"{source} does not exist; to write it, use {context.command_path} "
        return f"{hint}{shlex.quote(text)} -o {shlex.quote(str(source))}"
    if "--output" in flags and path.suffix:
        return f"to write it, use -o {text}"
    return None
