"""Situations that people reported, each with a command and with what is right."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from support.reported.accept import unmet
from support.reported.rows import Row, reported_rows
from support.reported.running import Run, commands, run_row
from support.suite import some_quick

# Folders whose rows are to hold; what is right already is run of all of them.
OWED = (
    "c3d",
    "hostile",
    "ik",
    "keys",
    "motion",
    "retarget",
    "rigid",
    "springs",
    "sto",
    "timelines",
    "trc",
    "turned",
    "units",
    "usd",
    "validate",
)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Run]:
    with commands(tmp_path_factory.mktemp("commands")) as run:
        yield run


@pytest.mark.slow
@pytest.mark.parametrize("row", some_quick(reported_rows(OWED), 4))
def test_a_reported_situation_is_right(row: Row, run: Run, tmp_path: Path) -> None:
    outcome = run_row(row, run, tmp_path)
    faults = unmet(outcome, row.accept)
    assert not faults, "\n".join([*faults, outcome.text.strip()])
