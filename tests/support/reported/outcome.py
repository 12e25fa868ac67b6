"""What a command of a row says and writes."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import pytest

from support.cli import Done
from support.normalise import normalise
from support.printed import ROOT, files_in

_CODE = re.compile(r"(?<!\w)(?:[A-Z]{2,5}|C3D)\d{3}(?!\w)")
# Every code has a page; names of joints and files may look like one.
_PAGES = ROOT / "animtool/docs/rules"


class UnmetError(AssertionError):
    """A result is not as a check asks."""


def require(holds: object, message: str) -> None:
    """Raise where something does not hold."""
    if not holds:
        raise UnmetError(message)


@dataclass(frozen=True)
class Outcome:
    """What is left of a command.

    Attributes:
        done: Exit code, texts and memory.
        folder: Where it ran.
        out: The folder for what it writes.
        name: Of the file that it read.
        run: Runs another command as this one was, into a folder of its own.
    """

    done: Done
    folder: Path
    out: Path
    name: str
    run: Callable[[list[str]], Outcome] | None = None

    @cached_property
    def text(self) -> str:
        """What it says, without the paths and the file names it was told."""
        text = f"{self.done.stdout}\n{self.done.stderr}"
        for path in sorted({self.out, self.folder}, key=lambda path: -len(str(path))):
            text = text.replace(str(path), "")
        return re.sub(rf"(?<![\w-]){re.escape(self.name)}(:\d+)*", "", text)

    @cached_property
    def codes(self) -> frozenset[str]:
        """The codes that it names."""
        found = _CODE.findall(f"{self.done.stdout}\n{self.done.stderr}")
        return frozenset(code for code in found if (_PAGES / f"{code}.md").exists())

    @cached_property
    def report(self) -> dict[str, Any]:
        """The report in JSON on stdout."""
        try:
            report = json.loads(self.done.stdout)
        except ValueError as error:
            raise UnmetError(f"stdout has no report in JSON: {error}") from None
        require(isinstance(report, dict), "the report in JSON is not an object")
        return dict(report)

    @property
    def information(self) -> dict[str, Any] | None:
        """What `info` says of its first file; None for other commands."""
        if not self.done.stdout.lstrip().startswith("{") or "info" not in self.report:
            return None
        files = self.report.get("files") or []
        require(files, "info names no file")
        return dict(files[0])

    @property
    def files(self) -> list[str]:
        """The files that it wrote."""
        return [path.as_posix() for path in files_in(self.out)]

    def file(self, of: str | None = None) -> Path:
        """Return the file of a name, else the first that it wrote."""
        if of is not None:
            path = next(
                (p for p in (self.out / of, self.folder / of) if p.is_file()), None
            )
            require(path, f"there is no {of}")
            assert path is not None
            return path
        shown = [name for name in self.files if not name.startswith(".")]
        require(shown, "no file was written")
        return self.out / shown[0]

    def lines(self, code: str | None = None) -> list[str]:
        """Return what it says, line by line; of a code only those that have it.

        A finding in JSON counts as one line. How long it took is left out.
        """
        lines = normalise(self.text).splitlines()
        if self.done.stdout.lstrip().startswith("{"):
            lines += [
                " ".join(map(str, found.values())) for found in _findings(self.report)
            ]
        return [line for line in lines if code is None or code in line]


def _findings(value: Any) -> list[dict[str, Any]]:
    """Return the objects in JSON that have a code."""
    if isinstance(value, list):
        return [found for each in value for found in _findings(each)]
    if not isinstance(value, dict):
        return []
    own = [value] if "code" in value else []
    return own + [found for each in value.values() for found in _findings(each)]


def close(value: float, wanted: float, tolerance: float) -> bool:
    """Return whether a number is another, NaN is none."""
    return bool(value == pytest.approx(wanted, abs=tolerance, rel=0.0))
