"""What a batch is at: a live table on a terminal, lines elsewhere."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from animtool.cli.console import Console
from animtool.printing import escaped, json_printed

if TYPE_CHECKING:
    from rich.console import RenderableType

    from animtool.batch.recipe import Item
    from animtool.batch.report import ItemReport
    from animtool.batch.run import Listener

WIDTH = 40


@contextmanager
def shown_progress(console: Console, *, lines: bool) -> Iterator[Listener]:
    """Give what a run tells what happens, which shows it.

    Args:
        console: Where.
        lines: Write each item that ended to stdout, as a line of JSON.
    """
    if not console.is_live():
        yield _lines(console, lines=lines)
        return
    from rich.console import Console as RichConsole
    from rich.live import Live

    shown, renderable = _table(lines=lines)
    # Drawn a few times a second, whatever happens in between.
    with Live(
        get_renderable=renderable, console=RichConsole(stderr=True), transient=True
    ):
        yield shown


def _lines(console: Console, *, lines: bool) -> Listener:
    from animtool.batch.run import Listener
    from animtool.cli.batch_summary import ended_text

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
                _write(report)
            else:
                console.say(ended_text(report, self.ended_items, self.due))

    return Lines()


def _table(*, lines: bool) -> tuple[Listener, Callable[[], RenderableType]]:
    from rich.console import Group
    from rich.progress_bar import ProgressBar
    from rich.table import Table
    from rich.text import Text

    from animtool.batch.run import Listener

    class Shown(Listener):
        """Knows how much is done, what failed, and what is being made since when."""

        due = ended_items = failed = 0

        def __init__(self) -> None:
            self.running: dict[int, tuple[str, float]] = {}

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
            if lines:
                _write(report)

    shown = Shown()

    def drawn() -> RenderableType:
        if not shown.due:
            return Text()
        told = f"{shown.ended_items} of {shown.due}"
        told += f", {shown.failed} failed" if shown.failed else ""
        head = Table.grid(padding=(0, 1))
        bar = ProgressBar(shown.due, shown.ended_items, width=WIDTH)
        head.add_row(bar, Text(told))
        rows = Table.grid(padding=(0, 1))
        for name, began in list(shown.running.values()):
            rows.add_row(
                Text(f"{time.perf_counter() - began:6.1f} s"), Text(escaped(name))
            )
        return Group(head, rows)

    return shown, drawn


def _write(report: ItemReport) -> None:
    sys.stdout.write(json_printed(report.as_dict(), ascii_only=True) + "\n")
    sys.stdout.flush()
