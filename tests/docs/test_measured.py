"""What the page on accuracy and speed quotes is what was measured."""

from __future__ import annotations

import re

from support.measured_tables import (
    PAGE,
    RATIOS,
    REPORT_MODELS,
    ROOT,
    is_older_form,
    measured,
    renewed,
)

# Tasks of the table whose ratios the README quotes, in its order.
QUOTED = ("curves, all in one call", "joints in the world", "skin and shapes")
FIGURE = re.compile(r"(\d[\d.,]*)\s+times")
# Other forms of times, sizes and ratios.
UNITS = r"seconds|ms|µs|s|\u00d7|x|-?fold|%|percent|fps|kB|MB|GB|kilobytes|megabytes"
OTHER_FIGURE = re.compile(rf"\d[\d.,]*\s*(?:{UNITS})(?!\w)")


def test_the_table_is_of_the_results() -> None:
    text = PAGE.read_text("utf-8")
    assert renewed(text) == text, "run tests/support/measured_tables.py"


def test_it_has_a_row_that_is_slower() -> None:
    assert any(float(measured(ratio).split(",")[0]) < 1 for ratio in RATIOS)


def test_its_plots_and_tables_are_committed() -> None:
    named = re.findall(r"bench/results/([\w.]+)", PAGE.read_text("utf-8"))
    assert len(set(named)) > 5
    assert all((REPORT_MODELS / name).is_file() for name in named)


def test_the_readme_quotes_the_table_alone_and_results_of_the_present_form() -> None:
    text = (ROOT / "README.md").read_text("utf-8")
    figures = FIGURE.findall(text)
    assert len(figures) == len(QUOTED)
    ratios = {ratio.what: ratio for ratio in RATIOS}
    for figure, what in zip(figures, QUOTED, strict=True):
        assert figure == measured(ratios[what])
        assert not is_older_form(ratios[what].file)


def test_the_readme_has_no_other_figure() -> None:
    assert OTHER_FIGURE.findall((ROOT / "README.md").read_text("utf-8")) == []
    for figure in ("a quarter, 27\u00d7 as fast", "in .3 s", "a 2-fold", "12.5 MB."):
        assert OTHER_FIGURE.search(figure)
