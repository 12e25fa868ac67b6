"""Which tests run which line of the kernels: recorded once, and kept."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
from bisect import bisect_right
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path

from mutation.copies import Copy, RunError
from mutation.cover import earlier_lines

ADDRESS = re.compile(r"0x[0-9a-f]+")
PLACE = re.compile(r"^(.+):(\d+)")
CODE = re.compile(r"^\s*([0-9a-f]+):\s+(.*)")
FUNCTION = re.compile(r"^([0-9a-f]+) <.*>:$")
COUNTER = "<__sanitizer_cov_trace_pc>"
# A statement's later lines may have no code of their own: it is looked for above them.
STATEMENT_LINES = 8

Lines = dict[int, set[tuple[str, int]]]


def record(
    copy: Copy, library: Path, folder: Path, tests: Sequence[str], jobs: int
) -> None:
    """Run tests in a copy whose kernels mark what runs; keep it in a folder.

    Args:
        copy: The tree, with these kernels in its place.
        library: The kernels.
        folder: Where the recording goes.
        tests: Files and folders; all of them without any.
        jobs: How many processes run tests.
    """
    parts = folder.parent.with_name("kernel_hits")
    shutil.rmtree(parts, ignore_errors=True)
    parts.mkdir(parents=True)
    command = [copy.python, "-P", "-m", "pytest", "-q", "-p", "mutation.cpp_plugin"]
    command += ["-p", "no:cacheprovider", f"-n{jobs}", *tests]
    environment = {"PYTHONPATH": str(copy.root / "tests"), "KERNEL_HITS": str(parts)}
    done = subprocess.run(
        command, cwd=copy.root, env=os.environ | environment, check=False
    )
    if done.returncode not in (0, 1):
        raise RunError(f"pytest ended with {done.returncode}")
    keep(library, copy.root / "animtool/kernels", parts, folder)


def keep(library: Path, sources: Path, parts: Path, folder: Path) -> None:
    """Make one recording of the rows of each process."""
    fresh = folder.with_name(f"{folder.name}.partial")
    shutil.rmtree(fresh, ignore_errors=True)
    fresh.mkdir(parents=True)
    lines = lines_by_block(library, sources)
    (fresh / "lines.json").write_text(
        json.dumps({block: sorted(there) for block, there in lines.items()})
    )
    rows = [path.read_text("utf-8") for path in sorted(parts.glob("rows.*.jsonl"))]
    (fresh / "rows.jsonl").write_text("".join(rows), "utf-8")
    texts = {name: (sources / name).read_text("utf-8") for name in names_of(sources)}
    (fresh / "sources.json").write_text(json.dumps(texts))
    shutil.rmtree(folder, ignore_errors=True)
    fresh.rename(folder)


def source_files(folder: Path) -> list[Path]:
    """Return the C++ files of the folders in a folder."""
    return sorted(path for path in folder.glob("*/*") if path.suffix in {".h", ".cpp"})


def names_of(folder: Path) -> list[str]:
    """Return the C++ files of the folders in a folder, as `folder/file`."""
    return [path.relative_to(folder).as_posix() for path in source_files(folder)]


class Recording:
    """Lines of the kernels, and the tests that ran them.

    Attributes:
        seconds: What each test takes.
        failed: Tests that failed.
        lines: Tests by name of file and line.
        texts: The files as they were.
    """

    def __init__(self, folder: Path) -> None:
        self.texts: dict[str, str] = json.loads((folder / "sources.json").read_text())
        blocks: dict[str, list[tuple[str, int]]] = json.loads(
            (folder / "lines.json").read_text()
        )
        self.seconds: dict[str, float] = {}
        self.failed: set[str] = set()
        self.lines: dict[tuple[str, int], set[str]] = {
            (name, line): set() for there in blocks.values() for name, line in there
        }
        with (folder / "rows.jsonl").open("r", encoding="utf-8") as rows:
            for row in rows:
                test, self.seconds[test], passed, hits = json.loads(row)
                if not passed:
                    self.failed.add(test)
                for hit in hits:
                    for name, line in blocks.get(str(hit), ()):
                        self.lines[name, line].add(test)

    def tests(self, name: str, text: str, line: int) -> set[str]:
        """Return the tests that run a line of a file as it is now.

        Of a line without code, such as the first value of a member, those that run any
        line of the file.
        """
        then = earlier_lines(self.texts.get(name, ""), text).get(line)
        if then is None:
            return set()
        for above in range(then, then - STATEMENT_LINES, -1):
            if (name, above) in self.lines:
                # The compiler may give what a line does to the next one.
                near = [(name, above + off) for off in (-1, 0, 1)]
                return set().union(*(self.lines.get(one, set()) for one in near))
        own = [found for (file, _), found in self.lines.items() if file == name]
        return set().union(*own)

    def missed(self) -> list[tuple[str, int, str]]:
        """Return the lines with code that no test runs: file, line, text."""
        return [
            (name, line, self.texts[name].split("\n")[line - 1].strip())
            for (name, line), tests in sorted(self.lines.items())
            if not tests
        ]


def lines_by_block(library: Path, sources: Path) -> Lines:
    """Return the lines (name of a file, line) of each block of code, by its mark."""
    found = blocks(library)
    starts = [start for start, _ in found]
    names = set(names_of(sources))
    lines: Lines = defaultdict(set)
    rows = "\n".join(_output("objdump", "--dwarf=decodedline", library))
    addresses = "\n".join(sorted(set(ADDRESS.findall(rows))))
    block = -1
    # Each address, and below it its line and those of the calls that are inlined there.
    for row in _output("addr2line", "-i", "-a", "-e", library, text=addresses):
        if row.startswith("0x"):
            block = bisect_right(starts, int(row, 16)) - 1
        elif block >= 0 and (place := PLACE.match(row)):
            name = "/".join(place[1].split("/")[-2:])
            if name in names:
                lines[found[block][1]].add((name, int(place[2])))
    return lines


def blocks(library: Path) -> list[tuple[int, int]]:
    """Return blocks of code: the address each begins at, and that which marks it.

    A block begins with the call that marks it. What is before the first one of a
    function is of that block.
    """
    found = []
    called: int | None = None
    begun: int | None = None
    for line in _output("objdump", "-d", "--no-show-raw-insn", library):
        if function := FUNCTION.match(line):
            begun, called = int(function[1], 16), None
        elif code := CODE.match(line):
            address = int(code[1], 16)
            if called is not None:
                found.append((called, address))
            called = None
            if COUNTER in code[2]:
                called, begun = address if begun is None else begun, None
    return sorted(found)


def _output(*command: str | Path, text: str = "") -> list[str]:
    """Return what a program prints, by lines."""
    return subprocess.run(
        command, input=text, check=True, capture_output=True, text=True
    ).stdout.splitlines()
