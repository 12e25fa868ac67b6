"""The command group with lazily loaded commands, and the handler of errors."""

from __future__ import annotations

import errno
import os
import sys
from collections.abc import Sequence
from typing import NoReturn

import click

from animtool.cli.console import Console
from animtool.cli.help import LazyGroup
from animtool.core.arguments import name_arguments
from animtool.core.errors import (
    AnimtoolError,
    ExitCode,
    Fault,
    FormatError,
    OutputError,
    StrictError,
)
from animtool.core.process.signals import (
    TerminatedError,
    ending_signal,
    ignore_signals,
    install_signal_handlers,
    reraise_signal,
    signal_handlers,
    unblock_signals,
)
from animtool.core.process.supervisor import (
    Crash,
    can_supervise,
    crash_fault,
    exit_now,
    supervise,
)
from animtool.core.quantities import escaped

# Messages of loaders and libraries when memory is exhausted.
_MEMORY_MESSAGES = (
    "failed to map segment",
    "Cannot allocate memory",
    "can't start new thread",
    "std::bad_alloc",
)
MEMORY_HINT = (
    "allow more memory (ulimit -v, or the limit of the container), or reduce the "
    "work: fewer frames, a smaller system, -j 1 in a batch"
)
KILLED_HINT = (
    "the kernel's log (dmesg) or the farm's scheduler tells which; allow more memory "
    "or time, and run the same command again"
)


def is_out_of_memory(error: BaseException | None) -> bool:
    """Return whether an error, or its cause, reports that memory ran out."""
    visited_ids: set[int] = set()
    while error is not None and id(error) not in visited_ids:
        visited_ids.add(id(error))
        if isinstance(error, MemoryError):
            return True
        if isinstance(error, OSError) and error.errno == errno.ENOMEM:
            return True
        if isinstance(error, ImportError | RuntimeError | OSError):
            text = str(error)
            if any(words in text for words in _MEMORY_MESSAGES):
                return True
        error = error.__cause__ or error.__context__
    return False


def memory_fault(error: BaseException) -> Fault:
    """Return a fault for an out-of-memory error, with the size and the failed step."""
    description = str(error).strip().rstrip(".")
    message = f"out of memory: {description}" if description else "out of memory"
    function_name = _innermost_function(error)
    if function_name:
        message += f", needed in {function_name}"
    return Fault("IO013", message, hint=MEMORY_HINT)


def _innermost_function(error: BaseException) -> str:
    """Return the module and name of the innermost function of animtool on the stack."""
    innermost_name, traceback = "", error.__traceback__
    while traceback is not None:
        code_object = traceback.tb_frame.f_code
        # Paths of a checkout and of an installation have the same ending.
        path = code_object.co_filename.replace("\\", "/")
        prefix, _, module_path = path.rpartition("/animtool/")
        if prefix and module_path.endswith(".py"):
            module = module_path.removesuffix(".py").replace("/", ".")
            innermost_name = f"{module} ({code_object.co_name})"
        traceback = traceback.tb_next
    return innermost_name


def memory_limit_bytes() -> int | None:
    """Return the memory limit of this process [byte]; None for no limit."""
    try:
        import resource
    except ImportError:  # not on Windows
        return None
    limit_kinds = resource.RLIMIT_AS, resource.RLIMIT_DATA
    limits = {resource.getrlimit(kind)[0] for kind in limit_kinds}
    return min(limits - {resource.RLIM_INFINITY}, default=None)


def crash_reason(name: str, path: str = "") -> Fault | None:
    """Return a fault if the process was killed from outside, else None.

    ``path`` is the file that USD was reading, or "".
    """
    location = path or None
    if name == "SIGKILL":
        message = "killed from outside (SIGKILL): out of memory or a time limit"
        return Fault("IO014", message, location, (), KILLED_HINT)
    limit = memory_limit_bytes()
    if limit is None:
        return None
    message = f"the process ended ({name}) within its memory limit, "
    message += f"{limit / 1000000.0:,.0f} MB: libraries crash when memory runs out"
    return Fault("IO013", message, location, (), MEMORY_HINT)


# Commands below each heading of the help: where each is, and what it does.
SECTIONS = {
    "Make": {
        "bake": (
            "animtool.cli.bake:bake",
            "Bake a scene, clip, BVH, glTF, FBX or USD file to USD.",
        ),
        "retarget": (
            "animtool.cli.retarget:retarget",
            "Transfer a take to another rig, with planted feet held.",
        ),
        "ik": ("animtool.cli.ik:ik", "Solve the joints of a rig for targets."),
        "loop": ("animtool.cli.loop:loop", "Find the cycle of a take and repeat it."),
        "mocap": (
            "animtool.cli.mocap:mocap",
            "Turn captures into motion, and clean it.",
        ),
    },
    "Look and check": {
        "preview": (
            "animtool.cli.preview:preview",
            "Show files: a page that plays, stills and films.",
        ),
        "report": (
            "animtool.cli.report:report",
            "Measure time against error for the settings of a file.",
        ),
        "info": ("animtool.cli.info:info", "Show what is in a file."),
        "diff": ("animtool.cli.diff:diff", "Compare two takes or layers."),
        "validate": (
            "animtool.cli.validate:validate",
            "Check rigs, clips, scenes and captures.",
        ),
        "explain": ("animtool.cli.explain:explain", "Explain a code."),
    },
    "Files": {
        "convert": (
            "animtool.cli.convert:convert",
            "Convert a take to another format.",
        ),
        "schema": ("animtool.cli.schema:schema", "Print the JSON Schema of a file."),
        "migrate": ("animtool.cli.migrate:migrate", "Update files of older versions."),
    },
    "Many": {
        "batch": (
            "animtool.cli.batch:batch",
            "Bake many files on every core; can be resumed.",
        ),
        "job": ("animtool.cli.job:job", "Write a batch as a render farm job."),
    },
    "Setup": {
        "docs": (
            "animtool.cli.docs:docs",
            "Open or print a page of the documentation.",
        ),
        "plugins": (
            "animtool.cli.plugins:plugins",
            "List passes, readers, executors and other plug-ins.",
        ),
        "completion": (
            "animtool.cli.schema:completion",
            "Print a shell completion script.",
        ),
    },
}
COMMANDS = {
    name: entry for section in SECTIONS.values() for name, entry in section.items()
}
# Names of these commands in other tools.
OTHER_NAMES = {
    "view": "preview",
    "render": "preview",
    "show": "preview",
    "play": "preview",
    "import": "convert",
    "export": "convert",
    "check": "validate",
    "lint": "validate",
    "compare": "diff",
    "solve": "ik",
    "simulate": "bake",
    "farm": "job",
    "upgrade": "migrate",
}


def _show_version(ctx: click.Context, _: click.Parameter, is_requested: bool) -> None:
    if not is_requested or ctx.resilient_parsing:
        return
    from importlib.metadata import version
    from platform import python_version

    version_texts = [f"{name} {version(name)}" for name in ("usd-core", "numpy")]
    version_texts.append(f"Python {python_version()}")
    click.echo(f"animtool {version('animtool')} ({', '.join(version_texts)})")
    ctx.exit()


@click.group(
    cls=LazyGroup,
    sections=SECTIONS,
    other_names=OTHER_NAMES,
    file_command="bake",
    context_settings={"help_option_names": ["-h", "--help"]},
    epilog="Start here: animtool bake walk.bvh -o walk.usdc",
)
@click.option(
    "-V",
    "--version",
    is_flag=True,
    is_eager=True,
    expose_value=False,
    callback=_show_version,
    help="Show the versions of animtool, usd-core, numpy and Python.",
)
def cli() -> None:
    """Motion capture and keyframes in, USD animation layers out.

    Results go to stdout, everything else to stderr. Exit codes: 0 done, 1 findings,
    2 usage, 3 malformed input or unwritable output, 4 a tolerance missed, 5 nothing
    matched, 70 internal error, 130 interrupted (SIGINT), 143 terminated (SIGTERM).
    """


# Commands run in a child process in case USD crashes; these read no USD.
COMMANDS_WITHOUT_USD = {"completion", "docs", "explain", "migrate", "plugins", "schema"}
SUPERVISED_COMMANDS = COMMANDS.keys() - COMMANDS_WITHOUT_USD
HELP_FLAGS = {"-h", "--help"}


def main(arguments: Sequence[str] | None = None) -> NoReturn:
    """Run the command line and exit with its code."""
    argv = list(sys.argv[1:] if arguments is None else arguments)
    if (
        SUPERVISED_COMMANDS.isdisjoint(argv[:1])
        or HELP_FLAGS & {*argv}
        or not can_supervise()
    ):
        install_signal_handlers()
        exit_now(run(argv))

    def report_crash(crash: Crash) -> int:
        error: AnimtoolError | _CrashError = _CrashError(crash.name)
        fault = crash_reason(crash.name, crash.path)
        if fault is not None:
            error = OutputError(fault)
        elif crash.path:
            error = FormatError(crash_fault(crash.path, crash.signal_number))
        return _report_error(Console(logs_json=_logs_json(argv)), error)

    os._exit(supervise(lambda: run(argv), report_crash, _remove_leftovers))


class _CrashError(Exception):
    """The child process crashed while reading an unknown file."""


def _remove_leftovers(folders: Sequence[str], process_id: int) -> None:
    from pathlib import Path

    from animtool.core.files.leftovers import remove_leftovers

    remove_leftovers(map(Path, folders), process_id)


def run(arguments: Sequence[str]) -> int:
    """Run the command line and return its exit code."""
    console = Console(logs_json=_logs_json(arguments))
    if hasattr(sys.stdout, "reconfigure") and not sys.stdout.isatty():
        # usda and JSON are UTF-8, whatever the locale.
        sys.stdout.reconfigure(encoding="utf-8", errors="backslashreplace")
    if hasattr(sys.stderr, "reconfigure"):
        sys.stderr.reconfigure(errors="backslashreplace")
    with signal_handlers():
        try:
            return _run(arguments, console)
        except (KeyboardInterrupt, TerminatedError) as error:
            return _report_error(console, error)


def _run(arguments: Sequence[str], console: Console) -> int:
    """Run the command line and return its exit code; with `--debug`, raise errors."""
    streams = sys.stdout, sys.stderr
    try:
        unblock_signals()
        words = list(arguments)
        exit_code = cli.main(words, "animtool", standalone_mode=False, obj=console)
        sys.stdout.flush()
        if ending_signal():
            reraise_signal()
        ignore_signals()
    except SystemExit:
        if (sys.stdout, sys.stderr) == streams:
            raise
        # Click converts both, and exits with 1 if stdout is closed.
        sys.stdout, sys.stderr = streams
        exit_code = _report_error(console, BrokenPipeError())
    except (Exception, click.Abort) as error:
        if ending_signal():
            # The exception of the signal was swallowed, or replaced by another error.
            reraise_signal()
        if console.debug:
            raise
        exit_code = _report_error(console, error)
        ignore_signals()
    return int(exit_code or 0)


def _report_error(console: Console, error: BaseException) -> int:
    """Print the error that ended the command, and return its exit code."""
    match error:
        case AnimtoolError():
            console.faults(_with_options(console, error.faults), is_fatal=True)
            if isinstance(error, StrictError):
                console.say("--strict treats warnings as errors: nothing was written")
            exit_code = int(error.exit_code)
        case click.exceptions.NoArgsIsHelpError() if not console.logs_json:
            error.show(sys.stderr)
            exit_code = int(ExitCode.USAGE)
        case click.ClickException():
            _report_usage_error(console, error)
            exit_code = int(ExitCode.USAGE)
        case KeyboardInterrupt() | click.Abort():
            console.error("interrupted")
            exit_code = int(ExitCode.INTERRUPTED)
        case TerminatedError():
            console.error("terminated")
            exit_code = int(ExitCode.TERMINATED)
        case _CrashError():
            console.error(
                f"internal error: the process crashed ({error})",
                "This is a bug in animtool or in a library. Please report it.",
            )
            exit_code = int(ExitCode.INTERNAL)
        case BrokenPipeError():
            # The reader of stdout is gone, which is no error; Python's flush at exit
            # must not report it either.
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            exit_code = int(ExitCode.OK)
        case _ if is_out_of_memory(error):
            console.faults([memory_fault(error)], is_fatal=True)
            exit_code = int(ExitCode.MALFORMED)
        case OSError():
            console.error(f"cannot be read or written: {error.strerror or error}")
            exit_code = int(ExitCode.MALFORMED)
        case _:
            console.error(
                f"internal error: {type(error).__name__}: {error}",
                "This is a bug in animtool. --debug shows where; please report it.",
            )
            exit_code = int(ExitCode.INTERNAL)
    return exit_code


def _with_options(console: Console, faults: Sequence[Fault]) -> Sequence[Fault]:
    """Return faults located at the command-line options that name their files."""
    from animtool.cli.usage import with_option

    context = console.context
    if context is None:
        return faults
    return [with_option(fault, context) for fault in faults]


def _logs_json(arguments: Sequence[str]) -> bool:
    """Return whether ``--log-format`` or ``ANIMTOOL_LOG_FORMAT`` selects JSON.

    This is determined before a command runs, so that usage errors are JSON too.
    """
    command_line = " ".join(arguments).replace("=", " ")
    is_default = os.environ.get("ANIMTOOL_LOG_FORMAT") == "json"
    return "--log-format json" in command_line or (
        is_default and "--log-format" not in command_line
    )


def _report_usage_error(console: Console, error: click.ClickException) -> None:
    from animtool.cli.usage import with_suggestion

    error = with_suggestion(error)
    text = name_arguments(error.format_message(), console.namer)
    if console.logs_json:
        console.error(text)
        return
    # All other errors repeat the command line.
    if not isinstance(error, click.MissingParameter):
        text = escaped(text)
    click.UsageError(text, getattr(error, "ctx", None)).show(file=sys.stderr)
