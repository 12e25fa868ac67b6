"""Reports of a batch and its items, as JSON keys and as JUnit."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from typing import ClassVar

from animtool.batch.discover import Batch
from animtool.batch.item import Item
from animtool.batch.plan import BuildReason
from animtool.batch.work import BakeMeasurements, ItemStatus
from animtool.core.arguments import ArgumentNamer
from animtool.core.errors import ExitCode, Fault, Severity
from animtool.core.junit import JunitCase, junit_xml
from animtool.core.record import dataclass
from animtool.core.values import template_values
from animtool.motion.scores import PassScores, sort_key_of_scores

# Number of slowest items, and of largest errors, in a summary.
MAX_LISTED_REPORTS = 3


@dataclass(frozen=True, slots=True)
class ItemReport:
    """Report of an item that was built, skipped or is planned."""

    item: Item
    status: ItemStatus
    reason: BuildReason  # why it was built or skipped
    detail: str = ""  # the changed file, or the last failure
    seconds: float = 0.0  # wall time; 0 if it was not built
    faults: tuple[Fault, ...] = ()  # why it failed
    notices: tuple[Fault, ...] = ()  # warnings and notes
    # Measurements of the bake; None if it was not built.
    measurements: BakeMeasurements | None = None
    # Scores of its passes, also from an earlier run.
    scores: tuple[PassScores, ...] = ()
    repeat_command: str = ""  # the command that repeats it, where it failed
    json_keys: ClassVar[str] = (
        "item=item.number input=item.file.path values=item.variant_values+ "
        "variables=item.variables+ output=item.output outputs=item.files+ status "
        "reason shot=item.shot? detail+ seconds=build_seconds?~ "
        "samples=measurements.sample_count? error=measurements?{meters=error joint} "
        "scores+ faults+ notices+ again=repeat_command+"
    )

    def with_argument_names(self, namer: ArgumentNamer) -> ItemReport:
        """Return a copy whose messages name arguments as commands, or Python, do."""
        faults, notices = (
            tuple(fault.with_argument_names(namer) for fault in fault_list)
            for fault_list in (self.faults, self.notices)
        )
        return replace(self, faults=faults, notices=notices)

    @property
    def skipped(self) -> bool:
        """Whether the item was, or would be, skipped."""
        return self.status is ItemStatus.SKIPPED

    @property
    def failed(self) -> bool:
        """Whether the item failed."""
        return self.status is ItemStatus.FAILED

    @property
    def build_seconds(self) -> float | None:
        """Wall time of the build [s]; None if it was not built."""
        was_built = self.status in {ItemStatus.DONE, ItemStatus.FAILED}
        return self.seconds if was_built else None

    @property
    def failure_text(self) -> str:
        """Why the item failed, in one line; empty if it did not."""
        if not self.faults:
            return ""
        first_fault, *others = self.faults
        more_text = f" (and {len(others)} more)" if others else ""
        return f"{first_fault.code} " + first_fault.message + more_text


@dataclass(frozen=True, slots=True)
class BatchReport:
    """Report of a run of a batch, or of its plan."""

    batch: Batch
    items: tuple[ItemReport, ...]  # considered items, in order
    seconds: float  # total wall time
    notices: tuple[Fault, ...] = ()  # warnings about records of earlier runs
    json_keys: ClassVar[str] = "*summary items"

    @property
    def summary(self) -> dict[str, object]:
        """The report without its items, as plain values."""
        return template_values(self, "'batch' *counts seconds~ notices+")

    @property
    def counts(self) -> dict[str, int]:
        """Number of items by status."""
        return {
            str(status).replace(" ", "_"): self.count(status) for status in ItemStatus
        }

    def count(self, status: ItemStatus) -> int:
        """Return the number of items with a status."""
        return sum(report.status is status for report in self.items)

    @property
    def reasons(self) -> Counter[BuildReason]:
        """Number of items for each reason."""
        return Counter(report.reason for report in self.items)

    @property
    def failed(self) -> list[ItemReport]:
        """Reports of the failed items in order."""
        return [report for report in self.items if report.failed]

    @property
    def slowest_items(self) -> list[ItemReport]:
        """Reports of the slowest items, slowest first."""
        built_reports = [
            report for report in self.items if report.status is ItemStatus.DONE
        ]
        return sorted(built_reports, key=lambda report: -report.seconds)[
            :MAX_LISTED_REPORTS
        ]

    @property
    def largest_errors(self) -> list[ItemReport]:
        """Reports of the items with the largest errors, largest first."""
        reports = [report for report in self.items if _largest_error(report) > 0]
        return sorted(reports, key=lambda report: -_largest_error(report))[
            :MAX_LISTED_REPORTS
        ]

    @property
    def items_with_scores(self) -> list[ItemReport]:
        """Reports of the items whose passes have scores, worst first."""
        reports = [report for report in self.items if report.scores]
        return sorted(reports, key=lambda r: sort_key_of_scores(r.scores), reverse=True)

    def notices_of_items(self) -> dict[Fault, list[ItemReport]]:
        """Return each distinct notice with the items that have it."""
        reports_by_notice: dict[Fault, list[ItemReport]] = {}
        for report in self.items:
            for notice in report.notices:
                reports_by_notice.setdefault(notice, []).append(report)
        return reports_by_notice

    @property
    def items_with_warnings(self) -> list[ItemReport]:
        """Reports of the items with warnings."""
        return [
            report
            for report in self.items
            if any(notice.severity is Severity.WARNING for notice in report.notices)
        ]

    @property
    def exit_code(self) -> ExitCode:
        """Exit code of a process that runs the batch."""
        return ExitCode.FINDINGS if self.failed else ExitCode.OK


def _largest_error(report: ItemReport) -> float:
    return 0.0 if report.measurements is None else report.measurements.error


def junit_report(reports: Sequence[ItemReport]) -> str:
    """Return a JUnit test suite with one test case per item."""
    return junit_xml("animtool batch", map(_junit_case, reports))


def _junit_case(report: ItemReport) -> JunitCase:
    name = str(report.item.output)
    warnings = (str(n) for n in report.notices if n.severity is not Severity.NOTE)
    output = "\n".join(warnings)
    if report.status is ItemStatus.FAILED:
        fault, text = report.faults[0], "\n".join(map(str, report.faults))
        failure_texts = (fault.code, fault.message, text)
        return JunitCase(name, "failure", *failure_texts, output, report.seconds)
    if report.status is ItemStatus.DONE:
        return JunitCase(name, output=output, seconds=report.seconds)
    return JunitCase(name, "skipped", message=str(report.reason))
