"""What a batch is at, in the lines that a session of Open Job Description reads."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from animtool.errors import AnimtoolError
from animtool.printing import escaped

if TYPE_CHECKING:
    from animtool.batch.recipe import Item
    from animtool.batch.report import ItemReport
    from animtool.batch.run import Listener


def openjd_lines(other: Listener) -> Listener:
    """Return a listener that writes such lines to stdout, and tells another."""
    from animtool.batch.run import Listener
    from animtool.batch.work import Status

    class Lines(Listener):
        """Writes progress, status and failures."""

        def __init__(self) -> None:
            self.total = self.ended_items = self.failed = 0

        def planned(self, due: int, total: int) -> None:
            """Say how many are to be made."""
            self.total = due
            _say("progress", f"{0 if due else 100:.1f}")
            _say("status", f"{due} of {total} to be made")
            other.planned(due, total)

        def began(self, item: Item) -> None:
            """Tell the other."""
            other.began(item)

        def ended(self, report: ItemReport) -> None:
            """Say how far it is, and what failed."""
            self.ended_items += 1
            output, count = report.item.output, f"{self.ended_items} of {self.total}"
            if report.status is Status.FAILED:
                self.failed += 1
                _say("fail", f"{self.failed} failed, at last {output}: {report.why}")
            _say("progress", f"{100 * self.ended_items / self.total:.1f}")
            _say("status", f"{count}: {report.status} {output}")
            other.ended(report)

    return Lines()


@contextmanager
def openjd_failure(*, asked: bool) -> Iterator[None]:
    """Say in such a line too what ends the whole, where that is asked for."""
    try:
        yield
    except AnimtoolError as error:
        if asked:
            _say("fail", str(error.faults[0]))
        raise


def _say(kind: str, text: str) -> None:
    sys.stdout.write(f"openjd_{kind}: {escaped(' '.join(text.split()))}\n")
    sys.stdout.flush()
