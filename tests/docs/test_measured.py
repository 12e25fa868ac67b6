"""What the page on accuracy and speed quotes is what was measured."""

from __future__ import annotations

import re

from support.measured_tables import PAGE, RATIOS, RESULTS, measured, renewed


def test_the_table_is_of_the_results() -> None:
    text = PAGE.read_text("utf-8")
    assert renewed(text) == text, "run tests/support/measured_tables.py"


def test_it_has_a_row_that_is_slower() -> None:
    assert any(float(measured(ratio).split(",")[0]) < 1 for ratio in RATIOS)


def test_its_plots_and_tables_are_committed() -> None:
    named = re.findall(r"bench/results/([\w.]+)", PAGE.read_text("utf-8"))
    assert len(set(named)) > 5
    assert all((RESULTS / name).is_file() for name in named)
