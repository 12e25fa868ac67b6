"""Rows of what was made."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from animtool.cli.plan_summary import stats_json


def report(*outputs: str) -> Any:
    """What a bake reports, as far as it is printed."""
    rounding = SimpleNamespace(rounding=SimpleNamespace(error=1e-6))
    return SimpleNamespace(
        result=SimpleNamespace(outputs=[Path(name) for name in outputs]),
        seconds={"total": 2.0},
        worst=SimpleNamespace(written=rounding),
    )


@pytest.mark.parametrize(
    ("outputs", "named"),
    [
        (("rig.usdc", "walk.usdc"), "walk.usdc"),
        (("one.usdc",), "one.usdc"),
        ((), "stdout"),
    ],
)
def test_the_last_file_names_an_output(outputs: tuple[str, ...], named: str) -> None:
    rows = stats_json([], [report(*outputs)])
    assert [row["output"] for row in rows if "output" in row] == [named]
