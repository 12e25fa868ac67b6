"""What a batch came to, in words and as JSON."""

from __future__ import annotations

from collections.abc import Callable

from animtool.batch.recipe import values_text
from animtool.batch.report import BatchReport, ItemReport
from animtool.batch.work import Status
from animtool.errors import counted
from animtool.quantities import length_text


def batch_text(report: BatchReport, *, dry: bool = False) -> list[str]:
    """Return the lines of a summary.

    Args:
        report: What became of the batch.
        dry: Nothing was made, and nothing was to be.
    """
    words = {Status.NOT_RUN: "to be made"} if dry else {}
    counts = [
        f"{count} {words.get(status, status)}"
        for status in Status
        if (count := report.count(status))
    ]
    reasons = report.reasons()
    why = ", ".join(f"{count} {reason}" for reason, count in reasons.most_common())
    total = counted(len(report.items), "item")
    lines = [f"{total}: {', '.join(counts) or 'nothing'} in {report.seconds:.2f} s"]
    if why:
        lines.append(f"  why: {why}")
    warned = len(report.warned())
    if warned:
        lines.append(f"  warnings: of {counted(warned, 'item')}")
    if report.slowest:
        slow = [
            f"{entry.item.output} {entry.seconds:.2f} s" for entry in report.slowest
        ]
        lines.append(f"  slowest: {', '.join(slow)}")
    if report.worst:
        lines.append(f"  largest errors: {', '.join(map(_error_text, report.worst))}")
    return lines


def _error_text(entry: ItemReport) -> str:
    assert entry.measured is not None
    found = entry.measured
    return f"{entry.item.output} {length_text(found.error, 2)} (joint {found.joint!r})"


def ended_text(entry: ItemReport, number: int, total: int) -> str:
    """Return the line of an item that ended.

    Args:
        entry: What became of it.
        number: How many have ended, it included.
        total: How many are to be made.
    """
    head = f"[{number}/{total}] {entry.status} {entry.item.output}"
    values = values_text(entry.item.values)
    if entry.status is Status.FAILED:
        return f"{head}{values}: {entry.why}"
    return f"{head}{values} ({entry.reason}) {entry.seconds:.2f} s"


def planned_text(report: BatchReport) -> list[str]:
    """Return a line for each item of a dry run: what would become of it, and why."""
    lines = []
    for entry in report.items:
        what = "skip" if entry.status is Status.SKIPPED else "make"
        detail = f": {entry.detail}" if entry.detail else ""
        values = values_text(entry.item.values)
        lines.append(f"{what} {entry.item.output}{values} ({entry.reason}{detail})")
    return lines


def report_json(
    report: BatchReport, command: Callable[[ItemReport], str]
) -> dict[str, object]:
    """Return the report as plain values.

    Args:
        report: What became of the batch.
        command: Returns what makes an item again.
    """
    items = []
    for entry in report.items:
        plain = entry.as_dict()
        if entry.status is Status.FAILED:
            plain["again"] = command(entry)
        items.append(plain)
    return {**report.as_dict(), "items": items}
