"""What a batch is at: a live table on a terminal, lines elsewhere."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from animtool.cli.console import Console

if TYPE_CHECKING:
    from animtool.batch.recipe import Item
    from animtool.batch.report import ItemReport
    from animtool.batch.run import Listener

__all__ = ["shown_progress"]


@contextmanager
def shown_progress(console: Console, *, lines: bool) -> Iterator[Listener]:
    """Give what a run tells what happens, which shows it.

    Args:
        console: Where.
        lines: Write each item that ended to stdout, as a line of JSON.
    """
    if console.is_live():
        bar = _bar()
        shown: Listener = _live(bar, console, lines=lines)
        try:
            yield shown
        finally:
            bar.stop()
    else:
        yield _plain(console, lines=lines)


def _plain(console: Console, *, lines: bool) -> Listener:
    from animtool.batch.run import Listener
    from animtool.cli.batch_summary import ended_text

    class Lines(Listener):
        """Says each item in a line."""

        def __init__(self) -> None:
            self.total = self.ended_items = 0

        def planned(self, due: int, total: int) -> None:
            """Say how many are to be made."""
            self.total = due
            if due < total:
                console.say(f"{total - due} of {total} are up to date")

        def ended(self, report: ItemReport) -> None:
            """Say what became of one."""
            self.ended_items += 1
            if lines:
                _line(report)
            else:
                console.say(ended_text(report, self.ended_items, self.total))

    return Lines()


def _live(bar: Any, console: Console, *, lines: bool) -> Listener:
    from animtool.batch.run import Listener

    class Live(Listener):
        """Shows what is being made, how much is done and what failed."""

        def __init__(self) -> None:
            self.whole: Any = None
            self.failed = 0
            self.rows: dict[int, Any] = {}

        def planned(self, due: int, total: int) -> None:
            """Begin to show, where there is something to do."""
            if due:
                self.whole = bar.add_task(f"{due} of {total}", total=due)
                bar.start()

        def began(self, item: Item) -> None:
            """Show what is begun."""
            self.rows[item.number] = bar.add_task(f"  {item.output}", total=None)

        def ended(self, report: ItemReport) -> None:
            """Show how much is done."""
            bar.remove_task(self.rows.pop(report.item.number))
            self.failed += bool(report.faults)
            told = f", {self.failed} failed" if self.failed else ""
            done = bar.tasks[0].completed + 1
            text = f"{int(done)} of {int(bar.tasks[0].total)}{told}"
            bar.update(self.whole, advance=1, description=text)
            if lines:
                _line(report)

    del console
    return Live()


def _bar() -> Any:
    from rich.console import Console as RichConsole
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    return Progress(
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        TimeElapsedColumn(),
        console=RichConsole(stderr=True),
        transient=True,
    )


def _line(report: ItemReport) -> None:
    sys.stdout.write(json.dumps(report.as_dict(), allow_nan=False) + "\n")
    sys.stdout.flush()
