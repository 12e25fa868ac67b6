"""Which tests run which line of Python: recorded once, with coverage.py, and kept.

A recording holds the texts of the files it was made with; lines that changed place
since are found again. What a later recording says of a test counts too.
"""

from __future__ import annotations

import ast
import json
import os
import re
import shutil
import subprocess
from bisect import bisect_right
from collections.abc import Iterable, Iterator, Sequence
from difflib import SequenceMatcher
from functools import cached_property
from pathlib import Path
from typing import Any

from mutation.copies import Copy, RunError
from mutation.mutants import Mutant
from mutation.plugin import FIXTURE

Function = ast.FunctionDef | ast.AsyncFunctionDef


def record(copy: Copy, folder: Path, arguments: Sequence[str], jobs: int) -> Path:
    """Run tests in a copy and keep what they run; return the folder of the recording.

    Args:
        copy: The tree.
        folder: Where recordings are kept.
        arguments: Files and folders of tests; all of them without any.
        jobs: How many processes run tests.
    """
    folder.mkdir(parents=True, exist_ok=True)
    target = folder / f"{len(list(folder.iterdir())):04d}"
    parts = folder.with_name("recording")
    shutil.rmtree(parts, ignore_errors=True)
    parts.mkdir()
    command = [copy.python, "-P", "-m", "pytest", "-q", "-p", "mutation_plugin"]
    command += ["-p", "no:cacheprovider", f"-n{jobs}", *arguments]
    environment = os.environ | {"MUTATION_COVER": str(parts)}
    done = subprocess.run(command, cwd=copy.root, env=environment, check=False)
    if done.returncode not in (0, 1):
        raise RunError(f"pytest ended with {done.returncode}")
    keep(copy.root, parts, target)
    return target


def keep(root: Path, parts: Path, target: Path) -> None:
    """Make one recording of what each process recorded."""
    import coverage

    fresh = target.with_name(f"{target.name}.partial")
    shutil.rmtree(fresh, ignore_errors=True)
    fresh.mkdir(parents=True)
    whole = coverage.Coverage(
        data_file=str(fresh / "data"),
        config_file=False,
        source=[str(root / "animtool")],
    )
    whole.combine([str(parts)], keep=True)
    whole.save()
    rows = [
        line
        for path in sorted(parts.glob("tests.*.jsonl"))
        for line in path.read_text("utf-8").splitlines()
    ]
    (fresh / "tests.jsonl").write_text("\n".join(rows) + "\n", "utf-8")
    sources = {
        str(path.relative_to(root)): path.read_text("utf-8")
        for path in sorted((root / "animtool").rglob("*.py"))
    }
    (fresh / "sources.json").write_text(
        json.dumps({"root": str(root), "files": sources})
    )
    fresh.rename(target)


class Recording:
    """One recording: lines, and the tests that ran them."""

    def __init__(self, folder: Path) -> None:
        import coverage

        self.data = coverage.CoverageData(str(folder / "data"))
        self.data.read()
        sources = json.loads((folder / "sources.json").read_text("utf-8"))
        self.root = Path(sources["root"])
        self.sources: dict[str, str] = sources["files"]
        lines = (folder / "tests.jsonl").read_text("utf-8").splitlines()
        rows: list[dict[str, Any]] = [json.loads(line) for line in lines]
        self.seconds = {row["test"]: float(row["seconds"]) for row in rows}
        self.failed = {row["test"] for row in rows if not row["passed"]}
        self.users: dict[str, set[str]] = {}
        for row in rows:
            for fixture in row["fixtures"]:
                self.users.setdefault(fixture, set()).add(row["test"])
        self._files: dict[str, dict[int, list[str]]] = {}

    def lines(self, path: str) -> dict[int, list[str]]:
        """Return the contexts of each line of a file, as the recording has it."""
        if path not in self._files:
            self._files[path] = self.data.contexts_by_lineno(str(self.root / path))
        return self._files[path]

    def near(self, path: str) -> set[str]:
        """Return the tests in the folder that mirrors that of a file."""
        return {test for test in self.seconds if test.startswith(mirrored(path))}

    def tests(self, path: str, text: str, wanted: Iterable[int]) -> set[str]:
        """Return the tests that run any of some lines of a file.

        Args:
            path: The file, relative to the root.
            text: The file as it is now.
            wanted: Lines of that text.
        """
        there = self.lines(path)
        found = {
            context
            for line in self._then(path, text, wanted)
            for context in there.get(line, ())
        }
        tests = found & self.seconds.keys()
        if "" in found:
            # It ran outside of tests too, as modules were imported.
            tests |= self.near(path)
        for context in found:
            if context.startswith(FIXTURE):
                tests |= self.users.get(context, set())
        return tests

    def _then(self, path: str, text: str, wanted: Iterable[int]) -> list[int]:
        """Return where lines stood when the recording was made."""
        old = self.sources.get(path, "")
        if old == text:
            return list(wanted)
        places = earlier_lines(old, text)
        # A line that is new is run by what runs the one above it.
        known = sorted(places)
        return [
            places[known[at - 1]]
            for line in wanted
            if (at := bisect_right(known, line)) > 0
        ]


def earlier_lines(old: str, text: str) -> dict[int, int]:
    """Return where lines of a text stood in an older one, those that are in both."""
    matcher = SequenceMatcher(None, old.split("\n"), text.split("\n"), autojunk=False)
    return {
        block.b + i + 1: block.a + i + 1
        for block in matcher.get_matching_blocks()
        for i in range(block.size)
    }


class Cover:
    """All recordings of a folder."""

    def __init__(self, root: Path, folder: Path) -> None:
        self.root = root
        kept = [path for path in folder.glob("*") if path.suffix != ".partial"]
        self.recordings = [Recording(path) for path in sorted(kept)]
        self.seconds: dict[str, float] = {}
        for recording in self.recordings:
            self.seconds |= recording.seconds

    @cached_property
    def texts(self) -> dict[str, str]:
        """The Python files of the package."""
        files = sorted((self.root / "animtool").rglob("*.py"))
        return {
            str(path.relative_to(self.root)): path.read_text("utf-8") for path in files
        }

    def ran(self, path: str, lines: Iterable[int]) -> set[str]:
        """Return the tests that run any of some lines."""
        chosen = list(lines)
        found: set[str] = set()
        for recording in self.recordings:
            found |= recording.tests(path, self.texts[path], chosen)
        return found

    def tests(self, mutant: Mutant) -> set[str]:
        """Return the tests that run a mutant's line, or what a module makes of it.

        What runs as a module is imported is run by no test of its own: its tests are
        those of the mirrored folder, and those that run the functions and methods that
        its names occur in.
        """
        tree = ast.parse(self.texts[mutant.path])
        line = mutant.edit.line
        around = [
            node
            for node in ast.walk(tree)
            if isinstance(node, ast.stmt)
            and _first_line(node) <= line <= (node.end_lineno or 0)
        ]
        functions = [node for node in around if isinstance(node, Function)]
        if any(node.body[0].lineno <= line for node in functions):
            found = self.ran(mutant.path, [line])
            first = max(node.lineno for node in around)
            return found or self.ran(mutant.path, range(first, line + 1))
        near = set().union(*(one.near(mutant.path) for one in self.recordings))
        if functions:
            return near | self.ran(mutant.path, _body_lines(functions))
        outer = [node for node in tree.body if node in around]
        names = set().union(*map(_bound, outer))
        found = near | self.ran(mutant.path, _body_lines(outer))
        if not names:
            return found
        pattern = re.compile(rf"\b(?:{'|'.join(map(re.escape, sorted(names)))})\b")
        stem = Path(mutant.path).stem
        for path, text in self.texts.items():
            module = Path(path).parent.name if stem == "__init__" else stem
            if path != mutant.path and not re.search(rf"\b{module}\b", text):
                continue
            if pattern.search(text):
                found |= self.ran(path, _using_lines(text, pattern))
        return found


def mirrored(path: str) -> str:
    """Return how the names of tests begin that mirror a module's folder.

    >>> mirrored("animtool/cli/loop.py"), mirrored("animtool/__main__.py")
    ('tests/cli/', 'tests/test___main__.py')
    """
    folder = Path(path).relative_to("animtool").parent.as_posix()
    return f"tests/test_{Path(path).stem}.py" if folder == "." else f"tests/{folder}/"


def _first_line(node: ast.stmt) -> int:
    """Return where a statement begins, with its decorators."""
    decorators: list[ast.expr] = getattr(node, "decorator_list", [])
    return min(one.lineno for one in (node, *decorators))


def _body_lines(nodes: Iterable[ast.AST]) -> list[int]:
    """Return the lines inside of functions."""
    return sorted(
        {
            line
            for outer in nodes
            for node in ast.walk(outer)
            if isinstance(node, Function)
            for line in range(node.body[0].lineno, (node.end_lineno or 0) + 1)
        }
    )


def _using_lines(text: str, pattern: re.Pattern[str]) -> Iterator[int]:
    """Yield the lines of functions and methods in which names occur.

    Names that occur in a class or at the top stand for what uses that: all functions.
    """
    tree = ast.parse(text)
    lines = text.split("\n")
    inside = _body_lines([tree])
    used = {i for i, line in enumerate(lines, 1) if pattern.search(line)}
    hits = used.intersection(inside)
    yield from hits
    for node in tree.body:
        if isinstance(node, ast.Import | ast.ImportFrom):
            continue
        own = set(range(node.lineno, (node.end_lineno or 0) + 1))
        if own & (used - hits):
            yield from _body_lines([node] if isinstance(node, ast.ClassDef) else [tree])


def _bound(node: ast.stmt) -> set[str]:
    """Return the names that a statement of a module binds."""
    if isinstance(node, ast.ClassDef | Function):
        return {node.name}
    return {
        one.id
        for one in ast.walk(node)
        if isinstance(one, ast.Name) and isinstance(one.ctx, ast.Store)
    }
