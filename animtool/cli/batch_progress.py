"""What a batch is at, and what it came to: a live table, lines, JSON."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING

from animtool.batch.item import values_text
from animtool.batch.report import BatchReport, ItemReport
from animtool.batch.run import Listener
from animtool.batch.work import ItemStatus
from animtool.cli.console import Console
from animtool.core.arguments import Calling
from animtool.core.errors import AnimtoolError, Fault, counted
from animtool.core.quantities import escaped, json_printed, length_text
from animtool.core.values import plain_value
from animtool.report.text import Each, Template, columns

if TYPE_CHECKING:
    from rich.console import RenderableType

    from animtool.batch.item import Item

MAX_ROWS = 20  # of takes in a table


def _counts(report: BatchReport, unmade: str = str(ItemStatus.NOT_RUN)) -> str:
    counts = ((report.count(status), status) for status in ItemStatus)
    words = {ItemStatus.NOT_RUN: unmade}
    return ", ".join(f"{count} {words.get(s, s)}" for count, s in counts if count)


def _item(entry: ItemReport) -> str:
    return f"{entry.item.output}{values_text(entry.item.values)}"


def _error_text(entry: ItemReport) -> str:
    assert entry.measured is not None
    measured = entry.measured
    error = length_text(measured.error, 2)
    return f"{entry.item.output} {error} (joint {measured.joint!r})"


def ended_text(entry: ItemReport, number: int, total: int) -> str:
    """Return the line of an item that ended."""
    head = f"[{number}/{total}] {entry.status} {_item(entry)}"
    if entry.status is ItemStatus.FAILED:
        return f"{head}: {entry.why}"
    return f"{head} ({entry.reason}) {entry.seconds:.2f} s"


def report_json(
    report: BatchReport, command: Callable[[ItemReport], str]
) -> dict[str, object]:
    """Return the report as plain values."""
    items = [
        plain_value(entry)
        | ({"again": command(entry)} if entry.status is ItemStatus.FAILED else {})
        for entry in report.items
    ]
    return {**report.summary, "items": items}


def openjd_lines(other: Listener, calling: Calling) -> Listener:
    """Return a listener that writes such lines to stdout, and tells another."""

    class Lines(Listener):
        """Writes progress, status and failures."""

        def __init__(self) -> None:
            self.total = self.ended_items = self.failed = 0

        def planned(self, due: int, total: int) -> None:
            """Say how many are to be made."""
            self.total = due
            _say("progress", f"{0 if due else 100:.1f}")
            _say("status", f"{due} of {total} to build")
            other.planned(due, total)

        def began(self, item: Item) -> None:
            """Tell the other."""
            other.began(item)

        def ended(self, report: ItemReport) -> None:
            """Say how far it is, and what failed."""
            self.ended_items += 1
            output, count = report.item.output, f"{self.ended_items} of {self.total}"
            if report.status is ItemStatus.FAILED:
                self.failed += 1
                why = report.worded(calling).why
                _say("fail", f"{self.failed} failed, the last is {output}: {why}")
            _say("progress", f"{100 * self.ended_items / self.total:.1f}")
            _say("status", f"{count}: {report.status} {output}")
            other.ended(report)

        def warned(self, notice: Fault) -> None:
            """Tell the other."""
            other.warned(notice)

    return Lines()


@contextmanager
def openjd_failure(calling: Calling, *, asked: bool) -> Iterator[None]:
    """Say in such a line too what ends the whole, where that is asked for."""
    try:
        yield
    except AnimtoolError as error:
        if asked:
            _say("fail", str(error.faults[0].worded(calling)))
        raise


def _say(kind: str, text: str) -> None:
    sys.stdout.write(f"openjd_{kind}: {escaped(' '.join(text.split()))}\n")
    sys.stdout.flush()


WIDTH = 40


@contextmanager
def shown_progress(console: Console, *, lines: bool) -> Iterator[Listener]:
    """Give what a run tells what happens, which shows it."""
    if not console.is_live():
        yield _lines(console, lines=lines)
        return
    from rich.console import Console as RichConsole
    from rich.live import Live

    shown, renderable = _table(console, lines=lines)
    # Drawn a few times a second, whatever happens in between.
    with Live(
        get_renderable=renderable, console=RichConsole(stderr=True), transient=True
    ):
        yield shown


def _lines(console: Console, *, lines: bool) -> Listener:
    class Lines(Listener):
        """Says each item in a line."""

        due = ended_items = 0

        def planned(self, due: int, total: int) -> None:
            """Say how many are to be made."""
            self.due = due
            if due < total:
                console.say(f"{total - due} of {total} are up to date")

        def ended(self, report: ItemReport) -> None:
            """Say what became of one."""
            self.ended_items += 1
            if lines:
                _write(report.worded(console.calling))
            else:
                told = report.worded(console.calling)
                console.say(ended_text(told, self.ended_items, self.due))

        def warned(self, notice: Fault) -> None:
            """Show a warning when it comes."""
            self.shown = (*self.shown, notice)
            console.faults([notice])

    return Lines()


def _table(
    console: Console, *, lines: bool
) -> tuple[Listener, Callable[[], RenderableType]]:
    from rich.console import Group
    from rich.progress_bar import ProgressBar
    from rich.table import Table
    from rich.text import Text

    class ProgressListener(Listener):
        """Knows how much is done, what failed, and what is being made since when."""

        due = ended_items = failed = 0

        def __init__(self) -> None:
            self.running: dict[int, tuple[str, float]] = {}
            self.warning = ""

        def planned(self, due: int, total: int) -> None:
            """Take how many are to be made."""
            del total
            self.due = due

        def began(self, item: Item) -> None:
            """Take what is begun."""
            self.running[item.number] = str(item.output), time.perf_counter()

        def ended(self, report: ItemReport) -> None:
            """Take what became of one."""
            self.running.pop(report.item.number, None)
            self.ended_items += 1
            self.failed += bool(report.faults)
            self.warning = ""
            if lines:
                _write(report.worded(console.calling))

        def warned(self, notice: Fault) -> None:
            """Take a warning, which is shown until an item ends, and at the end."""
            self.warning = str(notice.worded(console.calling))

    shown = ProgressListener()

    def drawn() -> RenderableType:
        if not shown.due:
            return Text()
        caption = f"{shown.ended_items} of {shown.due}"
        caption += f", {shown.failed} failed" if shown.failed else ""
        head = Table.grid(padding=(0, 1))
        bar = ProgressBar(shown.due, shown.ended_items, width=WIDTH)
        head.add_row(bar, Text(caption))
        rows = Table.grid(padding=(0, 1))
        for name, began in list(shown.running.values()):
            rows.add_row(
                Text(f"{time.perf_counter() - began:6.1f} s"), Text(escaped(name))
            )
        return Group(head, rows, Text(shown.warning))

    return shown, drawn


def _write(report: ItemReport) -> None:
    sys.stdout.write(json_printed(plain_value(report), ascii_only=True) + "\n")
    sys.stdout.flush()


def scores_table(items: Sequence[ItemReport]) -> list[str]:
    """Return a table for each pass that has scores.

    Args:
        items: The worst first, as the rows are.
    """
    places = dict.fromkeys(
        (one.pass_name, one.where) for entry in items for one in entry.scores
    )
    return [line for place in places for line in _pass_table(items, place)]


def _pass_table(items: Sequence[ItemReport], place: tuple[str, str]) -> Iterator[str]:
    """Yield the lines of the pass of a name and place."""
    table_rows = [
        (entry, one)
        for entry in items
        for one in entry.scores
        if (one.pass_name, one.where) == place
    ]
    names = [score.name for score in table_rows[0][1].scores]
    rows = [("  item", *names, "above usual")]
    for entry, one in table_rows[:MAX_ROWS]:
        texts = {score.name: score.text for score in one.scores}
        worse = ", ".join(score.name for score in one.worse)
        rows.append(
            (f"  {_item(entry)}", *(texts.get(name, "") for name in names), worse)
        )
    yield f"{place[0]} ({place[1]}), worst first:"
    yield from columns(rows, {0, len(names) + 1})
    if len(table_rows) > MAX_ROWS:
        rest = counted(len(table_rows) - MAX_ROWS, "item")
        yield f"  {rest} more, which are better; --format json lists all"


SUMMARY = Template(
    "animtool.batch.report:BatchReport",
    (
        "[{items:n item}|0 items]: [{self:counts}|nothing] in {seconds:.2f} s",
        "[  why: {reasons:common}]",
        "[  warnings: from {warned:n item}]",
        "[  slowest: {slowest:slow}]",
        "[  largest errors: {worst:errors}]",
        Each("scored:tables", ("{self}",)),
    ),
    {
        "counts": _counts,
        "common": lambda reasons: ", ".join(
            f"{count} {reason}" for reason, count in reasons.most_common()
        ),
        "slow": lambda entries: ", ".join(
            f"{one.item.output} {one.seconds:.2f} s" for one in entries
        ),
        "errors": lambda entries: ", ".join(map(_error_text, entries)),
        "tables": scores_table,
    },
)
# Of a dry run: how many are to be made, and what, each with the reason.
DRY = replace(
    SUMMARY,
    printers={**SUMMARY.printers, "counts": lambda one: _counts(one, "to build")},
)
PLANNED = Template(
    "animtool.batch.report:BatchReport",
    (
        Each(
            "items",
            ("[{?skipped}skip|make] {self:item} ({reason}[: {detail}])",),
        ),
    ),
    {"item": _item},
    is_result=True,
)
