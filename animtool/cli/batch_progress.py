"""Progress and results of a batch as a live table, as lines or as JSON."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING

from animtool.batch.item import variant_text
from animtool.batch.report import BatchReport, ItemReport
from animtool.batch.run import RunListener
from animtool.batch.work import ItemStatus
from animtool.cli.console import Console
from animtool.core.arguments import ArgumentNamer
from animtool.core.errors import AnimtoolError, Fault, counted
from animtool.core.quantities import escaped, length_text
from animtool.report.text import Each, Template, aligned_lines

if TYPE_CHECKING:
    from rich.console import RenderableType

    from animtool.batch.item import Item

MAX_TABLE_ROWS = 20  # maximum number of items in a table


def _counts_text(
    report: BatchReport, not_run_text: str = str(ItemStatus.NOT_RUN)
) -> str:
    counts = ((report.count(status), status) for status in ItemStatus)
    words = {ItemStatus.NOT_RUN: not_run_text}
    return ", ".join(
        f"{count} {words.get(status, status)}" for count, status in counts if count
    )


def _item_text(item_report: ItemReport) -> str:
    return f"{item_report.item.output}{variant_text(item_report.item.variant_values)}"


def _error_text(item_report: ItemReport) -> str:
    assert item_report.measurements is not None
    error = length_text(item_report.measurements.error, 2)
    return (
        f"{item_report.item.output} {error} (joint {item_report.measurements.joint!r})"
    )


def finished_text(item_report: ItemReport, number: int, total: int) -> str:
    """Return the line for an item that ended: status, reason and seconds, or fault."""
    prefix = f"[{number}/{total}] {item_report.status} {_item_text(item_report)}"
    if item_report.failed:
        return f"{prefix}: {item_report.failure_text}"
    return f"{prefix} ({item_report.reason}) {item_report.seconds:.2f} s"


def openjd_lines(inner_listener: RunListener, namer: ArgumentNamer) -> RunListener:
    """Return a listener that prints OpenJD lines and forwards events to another one."""

    class OpenJdLines(RunListener):
        """Prints the progress, status and failures of a batch for OpenJD."""

        def __init__(self) -> None:
            self.due_count = self.ended_count = self.failed_count = 0

        def on_plan(self, due_count: int, total_count: int) -> None:
            """Print the start of the progress, and forward the event."""
            self.due_count = due_count
            _write_openjd_line("progress", f"{0 if due_count else 100:.1f}")
            _write_openjd_line("status", f"{due_count} of {total_count} to build")
            inner_listener.on_plan(due_count, total_count)

        def on_start(self, item: Item) -> None:
            """Forward the event to the other listener."""
            inner_listener.on_start(item)

        def on_end(self, report: ItemReport) -> None:
            """Print the progress and a failure, and forward the event."""
            self.ended_count += 1
            output, counts = report.item.output, (self.ended_count, self.due_count)
            if report.failed:
                self.failed_count += 1
                reason = report.with_argument_names(namer).failure_text
                text = f"{self.failed_count} failed, the last is {output}: {reason}"
                _write_openjd_line("fail", text)
            _write_openjd_line("progress", f"{100 * counts[0] / counts[1]:.1f}")
            status = f"{counts[0]} of {counts[1]}: {report.status} {output}"
            _write_openjd_line("status", status)
            inner_listener.on_end(report)

        def on_warning(self, notice: Fault) -> None:
            """Forward the event to the other listener."""
            inner_listener.on_warning(notice)

    return OpenJdLines()


@contextmanager
def openjd_failure(namer: ArgumentNamer, *, is_requested: bool) -> Iterator[None]:
    """Print a fatal error of the block as an OpenJD line too, if requested."""
    try:
        yield
    except AnimtoolError as error:
        if is_requested:
            _write_openjd_line("fail", str(error.faults[0].with_argument_names(namer)))
        raise


def _write_openjd_line(message_type: str, text: str) -> None:
    sys.stdout.write(f"openjd_{message_type}: {escaped(' '.join(text.split()))}\n")
    sys.stdout.flush()


BAR_WIDTH = 40


@contextmanager
def show_progress(console: Console, *, prints_json: bool) -> Iterator[RunListener]:
    """Yield a listener that shows the progress of a run."""
    if not console.is_live():
        yield _line_listener(console, prints_json=prints_json)
        return
    from rich.console import Console as RichConsole
    from rich.live import Live

    listener, draw_table = _table_listener(console, prints_json=prints_json)
    # Redrawn a few times per second at most.
    with Live(
        get_renderable=draw_table, console=RichConsole(stderr=True), transient=True
    ):
        yield listener


def _line_listener(console: Console, *, prints_json: bool) -> RunListener:
    class TextLines(RunListener):
        """Prints one line for each finished item."""

        due_count = ended_count = 0

        def on_plan(self, due_count: int, total_count: int) -> None:
            """Store the number of items to build."""
            self.due_count = due_count
            skipped_count = total_count - due_count
            if skipped_count > 0:
                console.say(f"{skipped_count} of {total_count} are up to date")

        def on_end(self, report: ItemReport) -> None:
            """Print the result of one item."""
            self.ended_count += 1
            if prints_json:
                console.result_json(report, is_one_line=True)
            else:
                named_report = report.with_argument_names(console.namer)
                counts = self.ended_count, self.due_count
                console.say(finished_text(named_report, *counts))

        def on_warning(self, notice: Fault) -> None:
            """Print a warning."""
            self.shown_warnings = (*self.shown_warnings, notice)
            console.faults([notice])

    return TextLines()


def _table_listener(
    console: Console, *, prints_json: bool
) -> tuple[RunListener, Callable[[], RenderableType]]:
    from rich.console import Group
    from rich.progress_bar import ProgressBar
    from rich.table import Table
    from rich.text import Text

    class ProgressListener(RunListener):
        """Tracks finished, failed and running items with their start times."""

        due_count = ended_count = failed_count = 0

        def __init__(self) -> None:
            self.running_items: dict[int, tuple[str, float]] = {}
            self.warning = ""

        def on_plan(self, due_count: int, total_count: int) -> None:
            """Record the number of items to build."""
            del total_count
            self.due_count = due_count

        def on_start(self, item: Item) -> None:
            """Record a started item."""
            self.running_items[item.number] = str(item.output), time.perf_counter()

        def on_end(self, report: ItemReport) -> None:
            """Record a finished item."""
            self.running_items.pop(report.item.number, None)
            self.ended_count += 1
            self.failed_count += bool(report.faults)
            self.warning = ""
            if prints_json:
                console.result_json(report, is_one_line=True)

        def on_warning(self, notice: Fault) -> None:
            """Record a warning, shown until an item ends and again at the end."""
            self.warning = str(notice.with_argument_names(console.namer))

    tracker = ProgressListener()

    def draw() -> RenderableType:
        if not tracker.due_count:
            return Text()
        caption = f"{tracker.ended_count} of {tracker.due_count}"
        caption += f", {tracker.failed_count} failed" if tracker.failed_count else ""
        header = Table.grid(padding=(0, 1))
        bar = ProgressBar(tracker.due_count, tracker.ended_count, width=BAR_WIDTH)
        header.add_row(bar, Text(caption))
        running_rows = Table.grid(padding=(0, 1))
        for name, start_time in list(tracker.running_items.values()):
            seconds = Text(f"{time.perf_counter() - start_time:6.1f} s")
            running_rows.add_row(seconds, Text(escaped(name)))
        return Group(header, running_rows, Text(tracker.warning))

    return tracker, draw


def scores_table(items: Sequence[ItemReport]) -> list[str]:
    """Return the lines of a score table for each pass; items are sorted worst first."""
    passes = dict.fromkeys(
        (score.pass_name, score.where) for each in items for score in each.scores
    )
    return [line for pass_key in passes for line in _pass_table(items, pass_key)]


def _pass_table(
    items: Sequence[ItemReport], pass_key: tuple[str, str]
) -> Iterator[str]:
    """Yield the lines of the score table of one pass."""
    table_rows = [
        (item_report, pass_score)
        for item_report in items
        for pass_score in item_report.scores
        if (pass_score.pass_name, pass_score.where) == pass_key
    ]
    names = [score.name for score in table_rows[0][1].scores]
    score_rows = [("  item", *names, "above usual")]
    for item_report, pass_score in table_rows[:MAX_TABLE_ROWS]:
        texts = {score.name: score.text for score in pass_score.scores}
        worse_names = ", ".join(score.name for score in pass_score.exceeded_scores)
        values = (texts.get(name, "") for name in names)
        score_rows.append((f"  {_item_text(item_report)}", *values, worse_names))
    yield f"{pass_key[0]} ({pass_key[1]}), worst first:"
    yield from aligned_lines(score_rows, {0, len(names) + 1})
    if len(table_rows) > MAX_TABLE_ROWS:
        omitted_text = counted(len(table_rows) - MAX_TABLE_ROWS, "item")
        yield f"  {omitted_text} more, which are better; --format json lists all"


SUMMARY_TEMPLATE = Template(
    "animtool.batch.report:BatchReport",
    (
        "[{items:n item}|0 items]: [{self:counts}|nothing] in {seconds:.2f} s",
        "[  why: {reasons:common}]",
        "[  warnings: from {items_with_warnings:n item}]",
        "[  slowest: {slowest_items:slow}]",
        "[  largest errors: {largest_errors:errors}]",
        Each("items_with_scores:tables", ("{self}",)),
    ),
    {
        "counts": _counts_text,
        "common": lambda reasons: ", ".join(
            f"{count} {reason}" for reason, count in reasons.most_common()
        ),
        "slow": lambda entries: ", ".join(
            f"{entry.item.output} {entry.seconds:.2f} s" for entry in entries
        ),
        "errors": lambda entries: ", ".join(map(_error_text, entries)),
        "tables": scores_table,
    },
)
# Summary of a dry run: the number of items to build, and each with its reason.
DRY_RUN_TEMPLATE = replace(
    SUMMARY_TEMPLATE,
    printers={
        **SUMMARY_TEMPLATE.printers,
        "counts": lambda report: _counts_text(report, "to build"),
    },
)
PLANNED_TEMPLATE = Template(
    "animtool.batch.report:BatchReport",
    (Each("items", ("[{?skipped}skip|make] {self:item} ({reason}[: {detail}])",)),),
    {"item": _item_text},
    is_result=True,
)
