"""Mutants of animtool's Python, for the engine."""

from __future__ import annotations

import warnings
from pathlib import Path

from mutation.copies import Copy
from mutation.cover import Cover
from mutation.mutants import Mutant, read_unfit
from mutation.syntax import edits

__all__ = ["Tests", "edits", "packages", "plant", "restore", "size", "valid"]

FEWEST, LINES_FOR_ONE = 12, 200


def packages(root: Path) -> dict[str, list[Path]]:
    """Return the packages of animtool and their files; its modules are one more.

    Each kind of system is a package: ``systems/springs``.
    """
    found: dict[str, list[Path]] = {}
    for path in sorted((root / "animtool").rglob("*.py")):
        parts = path.relative_to(root / "animtool").parts[:-1]
        depth = 2 if parts[:1] == ("systems",) else 1
        found.setdefault("/".join(parts[:depth]) or "animtool", []).append(path)
    return found


def size(lines: int) -> int:
    """Return how many mutants to draw of a package."""
    return max(FEWEST, round(lines / LINES_FOR_ONE))


def valid(source: str) -> bool:
    """Return whether a file with a bug compiles."""
    try:
        with warnings.catch_warnings(action="error"):
            compile(source, "mutant", "exec", dont_inherit=True)
    except (SyntaxError, ValueError):
        return False
    return True


class Tests(Cover):
    """Finds tests by what coverage.py recorded."""

    def __init__(self, root: Path, state: Path) -> None:
        super().__init__(root, state / "cover")
        self.unfit = read_unfit(state)

    def __call__(self, mutant: Mutant) -> set[str]:
        """Return the tests that run a mutant's line."""
        return self.tests(mutant)


def plant(copy: Copy, mutant: Mutant, text: str) -> str:
    """Write a mutant."""
    copy.plant(mutant.path, text)
    return ""


def restore(copy: Copy, mutant: Mutant) -> None:
    """Write the file as it is."""
    copy.restore(mutant.path)
