"""BVH and USD files as their rules see them: a take."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

from animtool.errors import Fault
from animtool.scene.sources import open_source
from animtool.take import Take
from animtool.validation.rule import Kind
from animtool.validation.subjects.steps import Steps, steps_of
from animtool.validation.subjects.subject import Opened

__all__ = ["TakeSubject", "open_bvh", "open_usd"]


@dataclass(frozen=True, eq=False)
class TakeSubject:
    """A take, and the file that it was read from.

    Attributes:
        path: The file.
        take: All of it.
    """

    path: Path
    take: Take

    @cached_property
    def steps(self) -> Steps:
        """How far joints go from frame to frame."""
        return steps_of(self.take)

    def fault(self, code: str, joint: str, message: str, hint: str) -> Fault:
        """Return a fault of a joint, in the line that begins it."""
        line = self._lines.get(joint)
        lines = () if line is None else (line,)
        return Fault(code, message, str(self.path), lines, hint, where=joint)

    @cached_property
    def _lines(self) -> dict[str, int]:
        """Where joints begin, by name; those that the reader gave theirs have none."""
        found: dict[str, int] = {}
        with self.path.open(encoding="utf-8", errors="replace") as file:
            for number, line in enumerate(file, 1):
                keyword, _, name = line.strip().partition(" ")
                if keyword.upper() == "MOTION":
                    break
                if keyword.upper() in {"ROOT", "JOINT"}:
                    found.setdefault(name.strip(), number)
        return found


def open_bvh(path: Path) -> Opened:
    """Return a BVH as its rules see it, every row read.

    Raises:
        FormatError: It is malformed, with every fault.
    """
    return _opened(Kind.BVH, path)


def open_usd(path: Path) -> Opened:
    """Return what is wrong with a USD layer and what it brings in."""
    from animtool.usd.checks import check_layer

    return Opened(Kind.USD, check_layer(path))


def _opened(kind: Kind, path: Path) -> Opened:
    take = open_source(path).collect()
    faults = [f if f.path else replace(f, path=str(path)) for f in take.notices]
    return Opened(kind, faults, TakeSubject(path, take))
