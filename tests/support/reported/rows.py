"""Rows of the table of reported situations, as parameters of tests."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from support.data import data_files


@dataclass(frozen=True)
class Row:
    """A command over a file, and what is right.

    Attributes:
        root: Folder of the table.
        file: What the command reads, below the root.
        commands: Arguments; those after the first are for builds without its options.
        accept: Alternatives, one of which is to hold.
        control: Whether it is right already.
        project: Whether it runs among the rigs and samples.
    """

    root: Path
    file: Path
    commands: tuple[tuple[str, ...], ...]
    accept: tuple[dict[str, Any], ...]
    control: bool = False
    project: bool = False

    @property
    def folder(self) -> str:
        """The folder that it is in."""
        return self.file.parts[0]

    @property
    def name(self) -> str:
        """Its file and what is done with it."""
        verbs = [word for word in self.commands[0][:2] if word.isalpha()]
        return f"{self.file.as_posix()}-{'-'.join(verbs)}"

    @property
    def simulates(self) -> bool:
        """Whether systems of a scene are simulated."""
        if self.commands[0][0] != "bake" or not self.file.name.endswith(".scene.yaml"):
            return False
        return b"\nsystems:" in (self.root / self.file).read_bytes()


def read_rows(table: Path) -> list[Row]:
    """Return the rows of an ``expected.json``."""
    return [
        Row(
            table.parent,
            Path(entry["file"]),
            (tuple(entry["command"]), *map(tuple, entry.get("or_commands", ()))),
            tuple(entry["accept"]),
            bool(entry.get("control")),
            bool(entry.get("project")),
        )
        for entry in json.loads(table.read_text("utf-8"))
    ]


def reported_rows(owed: Collection[str]) -> list[Any]:
    """Return a parameter for each row of some folders, and for each control row."""
    parameters: list[Any] = []
    for table in data_files("reported", "expected.json"):
        if table.values[0] is None:
            return [table]
        seen: Counter[str] = Counter()
        for row in read_rows(table.values[0]):
            seen[row.name] += 1
            number = f"-{seen[row.name]}" if seen[row.name] > 1 else ""
            if row.control or row.folder in owed:
                marks = [pytest.mark.slow] if row.simulates else []
                name = f"{row.name}{number}"
                parameters.append(pytest.param(row, id=name, marks=marks))
    return parameters
