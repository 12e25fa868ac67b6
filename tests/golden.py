"""One hash for every result of animtool: proof that a refactor changed nothing.

Run it before and after on one machine, in one environment, and compare the lists::

    python tests/golden.py before.txt
    python tests/golden.py after.txt
    python tests/golden.py --compare before.txt after.txt

A list has one line a result: its hash, the exit code and the name of the case. The hash
of a command is that of stdout and stderr; each file that it wrote, changed or removed
has a line of its own, ``name > file``. Refused inputs count like any other. In place of
an exit code, ``timeout`` marks a command that took too long, ``internal`` is exit code
70, a fault of animtool's, and a name such as ``SIGSEGV`` is the signal that ended one.

Commands are those printed in the README, the documents, the pages of codes and the
READMEs of samples, in order, in one project a document, each behind those of other
documents whose files it needs; one that several documents have runs once where it can.
Every file of ``$ANIMTOOL_DATA/{bvh,rigs,usd}`` goes through bake, convert, info and
validate, every rig, clip and scene of ``samples`` and ``rigs`` through the last two.

What legitimately varies is replaced in printed text by `support.normalise` alone, which
names it. Files are hashed byte by byte, but for two kinds that are listed by name: the
records of a batch (times, process ids) and pictures of a table (durations). Absolute
paths stay as they are: all work is done in one folder, the same in each run.
"""

from __future__ import annotations

import argparse
import hashlib
import importlib
import multiprocessing
import os
import re
import shlex
import shutil
import signal
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import partial
from pathlib import Path

from filelock import FileLock
from support.normalise import normalise
from support.printed import (
    DOCUMENTS,
    ROOT,
    fenced,
    files_in,
    is_apart,
    make_project,
)
from support.sections import in_order

__all__ = ["Result", "compare", "main", "read_list", "written"]

DATA_FOLDERS = ("bvh", "rigs", "usd")
HAND_WRITTEN = ("*.rig.yaml", "*.clip.yaml", "*.scene.yaml")
CHECKS = {
    "info": "animtool info {file} --format json",
    "validate": "animtool validate {file} --format json",
}
VERBS = {
    "bake": "animtool bake {file} -o bake.usdc",
    "convert to BVH": "animtool convert {file} convert.bvh",
    "convert to clip": "animtool convert {file} convert.clip.yaml",
    "convert to rig": "animtool convert {file} convert.rig.yaml",
    **CHECKS,
}
# Imported once, before every command forks. USD starts threads only where it is used.
PRELOADED = (
    *("numpy", "scipy.optimize", "scipy.sparse.linalg", "scipy.spatial"),
    *("pxr.UsdSkel", "pydantic", "yaml", "animtool._kernels", "animtool.cli.bake"),
)
MEASURED_FILES = (".animtool/*", "*/.animtool/*")
DIGEST = re.compile("[0-9a-f]{64}|removed|measured")
INTERNAL = 70


@dataclass(frozen=True, slots=True)
class Result:
    """One line of a list: a hash, the exit code or its mark, and the case."""

    digest: str
    code: str
    name: str

    def __str__(self) -> str:
        return f"{self.digest} {self.code} {self.name}"


@dataclass(frozen=True, slots=True)
class Group:
    """Commands that run one after the other in one folder.

    Attributes:
        name: A document, a file, or a command that several documents have.
        cases: Name and command of each.
        prepare: Fills the folder.
        shared: Commands whose files come from the group of that name.
    """

    name: str
    cases: tuple[tuple[str, str], ...]
    prepare: Callable[[Path], object]
    shared: frozenset[str] = frozenset()

    def folder(self, base: Path) -> Path:
        """Return where it runs, the same whatever else does."""
        return base / "groups" / hashlib.sha256(self.name.encode()).hexdigest()[:12]


def document_groups() -> tuple[list[Group], list[Group]]:
    """Return groups of commands that several documents have, and of documents."""
    commands = {name: in_order(name) for name in DOCUMENTS}
    counts = Counter(command for found in commands.values() for command in set(found))
    shared = sorted(command for command, count in counts.items() if count > 1)
    return (
        [Group(name, ((name, name),), make_project) for name in shared],
        [
            Group(name, tuple(_numbered(name, found)), make_project, frozenset(shared))
            for name, found in commands.items()
        ],
    )


def page_groups() -> list[Group]:
    """Return a group for each block of commands of the pages of codes."""
    groups = []
    for path in sorted((ROOT / "animtool/docs/rules").glob("*.md")):
        text = path.read_text("utf-8")
        for number, block in enumerate(fenced(text, "(?:sh|console)"), 1):
            lines = block.replace("\\\n", " ")
            commands = re.findall(r"^(?:\$ )?(animtool .*)$", lines, re.M)
            name = f"{path.stem} {number}"
            groups.append(Group(name, tuple(_numbered(name, commands)), _make_stage))
    return groups


def file_groups(data: Path | None) -> Iterator[Group]:
    """Yield a group for each file of the data, and for each of samples and rigs."""
    for folder in DATA_FOLDERS if data else ():
        for file in files_in(data / folder):
            yield _file_group(f"{folder}/{file}", f"../../data/{folder}/{file}", VERBS)
    for folder in ("rigs", "samples"):
        for file in files_in(ROOT / folder):
            if any(file.match(pattern) for pattern in HAND_WRITTEN):
                path = f"../../project/{folder}/{file}"
                yield _file_group(f"{folder}/{file}", path, CHECKS)


def _file_group(name: str, path: str, verbs: dict[str, str]) -> Group:
    cases = (
        (f"{name}: {verb}", command.format(file=shlex.quote(path)))
        for verb, command in verbs.items()
    )
    return Group(name, tuple(cases), _make_nothing)


def _numbered(name: str, commands: Sequence[str]) -> Iterator[tuple[str, str]]:
    seen: Counter[str] = Counter()
    for command in commands:
        seen[command] += 1
        again = f" (run {seen[command]})" if seen[command] > 1 else ""
        yield f"{name}: {command}{again}", command


def _make_nothing(folder: Path) -> None:
    del folder


def _make_stage(folder: Path) -> None:
    # It imports numpy, which reads the environment.
    from support.page_stage import make_stage

    make_stage(folder)


def run_group(group: Group, base: Path, timeout: float) -> list[Result]:
    """Run the commands of a group, each in a process of its own."""
    folder = group.folder(base)
    folder.mkdir(parents=True)
    group.prepare(folder)
    results = []
    for number, (name, command) in enumerate(group.cases, 1):
        if command in group.shared and is_apart(command, folder):
            _copy_written(Group(command, (), group.prepare).folder(base), folder)
            continue
        printed = [base / "printed" / folder.name / f"{number}.{k}" for k in (1, 2)]
        printed[0].parent.mkdir(parents=True, exist_ok=True)
        with written(folder, name, command) as files:
            code = run_command(command, folder, printed, timeout)
        texts = [normalise(path.read_text("utf-8", "replace")) for path in printed]
        for path, text in zip(printed, texts, strict=True):
            path.write_text(text, "utf-8")
        digest = hashlib.sha256("\0".join(texts).encode("utf-8")).hexdigest()
        results.append(Result(digest, code, name))
        results += files
    return results


def run_command(
    command: str, folder: Path, printed: Sequence[Path], timeout: float
) -> str:
    """Run a command in a process of its own; return its exit code or a mark.

    Args:
        command: As printed; its first word is the program.
        folder: Where it runs.
        printed: Where stdout and stderr go.
        timeout: When it is killed, with every process that it started [s].
    """
    context = multiprocessing.get_context("fork")
    arguments = (shlex.split(command)[1:], folder, printed)
    process = context.Process(target=_command, args=arguments)
    process.start()
    try:
        process.join(timeout)
    finally:
        code = process.exitcode
        if code is None:
            process.kill()
            # Without a group of its own, it started nothing.
            with suppress(ProcessLookupError):
                os.killpg(process.pid or 0, signal.SIGKILL)
            process.join()
    if code is None:
        return "timeout"
    if code < 0:
        return signal.Signals(-code).name
    return "internal" if code == INTERNAL else str(code)


def _command(arguments: list[str], folder: Path, printed: Sequence[Path]) -> None:
    """Do what ``animtool`` does, in this process, which it ends."""
    os.setsid()
    os.chdir(folder)
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    for number, path in enumerate(printed, 1):
        os.dup2(os.open(path, os.O_CREAT | os.O_WRONLY), number)
    sys.stdout = open(1, "w", closefd=False)  # noqa: SIM115
    sys.stderr = open(2, "w", closefd=False, buffering=1)  # noqa: SIM115
    # What it starts imports animtool, and not this script.
    sys.modules["__main__"] = importlib.import_module("animtool.__main__")
    from animtool.cli.main import main as run

    run(arguments)


def _states(folder: Path) -> dict[Path, tuple[int, ...]]:
    states = {file: (folder / file).stat() for file in files_in(folder)}
    return {
        file: (state.st_ino, state.st_size, state.st_mtime_ns)
        for file, state in states.items()
    }


@contextmanager
def written(folder: Path, name: str, command: str) -> Iterator[list[Result]]:
    """Yield a list that gets a line for each file that the block wrote or removed."""
    results: list[Result] = []
    before = _states(folder)
    yield results
    after = _states(folder)
    for file in sorted(before.keys() | after.keys()):
        if before.get(file) == after.get(file):
            continue
        if file not in after:
            digest = "removed"
        elif _is_measured(file, command):
            digest = "measured"
        else:
            digest = hashlib.sha256((folder / file).read_bytes()).hexdigest()
        results.append(Result(digest, "-", f"{name} > {file.as_posix()}"))


def _is_measured(file: Path, command: str) -> bool:
    """Return whether a file has times or process ids, and is listed by name."""
    plotted = "--table" in command and file.name in shlex.split(command)
    record = any(fnmatchcase(file.as_posix(), pattern) for pattern in MEASURED_FILES)
    return plotted or record


def _copy_written(source: Path, target: Path) -> None:
    for file in files_in(source):
        if not (ROOT / file).exists():
            (target / file).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(source / file, target / file)


def compare(old: dict[str, Result], new: dict[str, Result]) -> list[str]:
    """Return a line for each case that is gone, added or changed, by name."""
    lines = []
    for name in sorted(old.keys() | new.keys()):
        before, after = old.get(name), new.get(name)
        if before is None:
            lines.append(f"added    {name}")
        elif after is None:
            lines.append(f"gone     {name}")
        elif before.code != after.code:
            lines.append(f"changed  {name} ({before.code}, now {after.code})")
        elif before.digest != after.digest:
            lines.append(f"changed  {name}")
    return lines


def read_list(path: Path) -> dict[str, Result]:
    """Return the results in a list, by name."""
    results = {}
    for number, line in enumerate(path.read_text("utf-8").splitlines(), 1):
        words = line.split(" ", 2)
        if len(words) < 3 or not re.fullmatch(
            "[0-9a-f]{64}|removed|measured", words[0]
        ):
            sys.exit(f"{path}:{number}: not a line of golden.py: {line}")
        results[words[2]] = Result(*words)
    return results


def run_all(options: argparse.Namespace, base: Path) -> Iterator[Result]:
    """Run every selected group; yield their results in order, whatever ``-j``."""
    data = Path(os.environ["ANIMTOOL_DATA"]) if "ANIMTOOL_DATA" in os.environ else None
    if data is None:
        sys.stderr.write("ANIMTOOL_DATA is not set: its files are left out\n")
    shared, documents = document_groups()
    groups = [
        group
        for group in (*documents, *file_groups(data), *page_groups())
        if fnmatchcase(group.name, options.only)
    ]
    needed = {command for group in groups for _, command in group.cases}
    first = [group for group in shared if group.name in needed]
    make_project(base / "project")
    for folder in DATA_FOLDERS if data else ():
        shutil.copytree(data / folder, base / "data" / folder)
    run = partial(run_group, base=base, timeout=options.timeout)
    context = multiprocessing.get_context("fork")
    with ProcessPoolExecutor(options.jobs, context) as pool:
        for stage in (first, groups):
            for results in pool.map(run, stage):
                yield from results


def main(arguments: Sequence[str] | None = None) -> int:
    """Write a list, or compare two; return the exit code."""
    parser = argparse.ArgumentParser(
        description="Write one hash for every result of animtool's documents, samples "
        "and data, or compare two such lists: exit code 1 if they differ.",
        epilog="The list depends on the machine and the environment; do not commit it.",
    )
    parser.add_argument("out", type=Path, metavar="OUT.txt", nargs="?")
    parser.add_argument(
        "--compare",
        type=Path,
        nargs=2,
        metavar=("OLD", "NEW"),
        help="print what differs by name: added, gone, changed",
    )
    parser.add_argument(
        "-j",
        dest="jobs",
        type=int,
        default=os.cpu_count(),
        metavar="N",
        help="commands that run at the same time (default: one a processor)",
    )
    parser.add_argument(
        "--only",
        default="*",
        metavar="PATTERN",
        help="documents, pages and files to run, such as 'README.md' or 'bvh/*'",
    )
    parser.add_argument(
        "--timeout",
        type=float,
        default=300,
        metavar="SECONDS",
        help="when a command is killed and marked 'timeout' (default: %(default)s)",
    )
    parser.add_argument(
        "--folder",
        type=Path,
        default=Path(tempfile.gettempdir(), "animtool-golden"),
        help="working folder, the same for lists to compare; what is in it is removed "
        "(default: %(default)s)",
    )
    parser.add_argument(
        "--keep", action="store_true", help="leave files and printed text in the folder"
    )
    options = parser.parse_args(arguments)
    if options.compare:
        lines = compare(*map(read_list, options.compare))
        sys.stdout.writelines(f"{line}\n" for line in lines)
        return int(bool(lines))
    if options.out is None:
        parser.error("name the list to write, or two to --compare")
    _set_environment()
    for module in PRELOADED:
        importlib.import_module(module)
    with FileLock(f"{options.folder}.lock", timeout=0):
        shutil.rmtree(options.folder, ignore_errors=True)
        results = list(run_all(options, options.folder.resolve()))
        if not options.keep:
            shutil.rmtree(options.folder)
    options.out.write_text("".join(f"{result}\n" for result in results), "utf-8")
    marks = Counter(result.code for result in results if result.code != "-")
    sys.stderr.write(f"{len(results)} results; exit codes: {dict(marks)}\n")
    return 0


def _set_environment() -> None:
    """Make what commands print independent of the terminal and of options."""
    for name in list(os.environ):
        if name.startswith("ANIMTOOL_") and name != "ANIMTOOL_DATA":
            del os.environ[name]
    os.environ.update(COLUMNS="80", OPENBLAS_NUM_THREADS="1")


if __name__ == "__main__":
    sys.exit(main())
