"""What is written where, and who looks at it."""

from __future__ import annotations

import sys

import pytest

from animtool.cli.console import Console


@pytest.mark.parametrize("verbosity", [-1, 0, 1])
def test_lines_by_verbosity(verbosity: int, capsys: pytest.CaptureFixture[str]) -> None:
    console = Console(verbosity)
    console.say("done")
    console.detail("took long")
    lines = capsys.readouterr().err.splitlines()
    assert lines == ["done", "took long"][: verbosity + 1]
    assert Console().verbosity == 0


def test_a_bar_is_shown_where_no_result_is_in_its_way(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for stream in (sys.stdout, sys.stderr):
        monkeypatch.setattr(stream, "isatty", lambda: True)
    with Console().progress("bake") as shown:
        assert shown is not None
    with Console().progress("bake", stdout=True) as shown:
        assert shown is None
    with Console(-1).progress("bake") as shown:
        assert shown is None
