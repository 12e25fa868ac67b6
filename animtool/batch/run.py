"""A run of a batch: planned, made, recorded, and reported to people and programs."""

from __future__ import annotations

import os
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from animtool.batch.discover import Batch, find_batch
from animtool.batch.executors import Executor, Work, find_executor
from animtool.batch.ledger import History, Ledger, held_ledger, read_history
from animtool.batch.manifest import ItemRecord
from animtool.batch.plan import (
    Decision,
    Planner,
    Reason,
    check_overwrites,
    check_places,
)
from animtool.batch.recipe import Item
from animtool.batch.spec import BatchSpec, named_from, place_of
from animtool.batch.work import Maker, Measured, Outcome, Status
from animtool.errors import ExitCode, Fault, OptionError, Severity
from animtool.junit import JunitCase, junit_xml
from animtool.leftovers import remove_leftovers
from animtool.scores import PassScores, badness

# How many of the slowest items, and of the worst errors, a summary names.
NAMED = 3


@dataclass(frozen=True, slots=True)
class ItemReport:
    """What became of an item."""

    item: Item  # the item
    status: Status  # what became of it
    reason: Reason  # why it was made, or not
    detail: str = ""  # the file that changed, or what happened last time
    seconds: float = 0.0  # wall time of making it; 0 where it was not made
    faults: tuple[Fault, ...] = ()  # why it failed
    notices: tuple[Fault, ...] = ()  # warnings and notes
    # What the bake measured; None where it was not made.
    measured: Measured | None = None
    scores: tuple[PassScores, ...] = ()  # how well passes did

    @classmethod
    def of(
        cls, item: Item, reason: Reason, detail: str, outcome: Outcome
    ) -> ItemReport:
        """Return the report of an item that was made, or failed."""
        return cls(
            item,
            outcome.status,
            reason,
            detail,
            outcome.seconds,
            outcome.faults,
            outcome.notices,
            outcome.measured,
            outcome.scores,
        )

    @property
    def why(self) -> str:
        """Why it failed, in a line."""
        if not self.faults:
            return ""
        more = f" (and {len(self.faults) - 1} more)" if len(self.faults) > 1 else ""
        return f"{self.faults[0].code} {self.faults[0].message}{more}"

    def as_dict(self) -> dict[str, object]:
        """Return it as plain values."""
        files = self.item.files
        found: dict[str, object] = {
            "item": self.item.number,
            "input": str(self.item.found.path),
            **({"values": dict(self.item.values)} if self.item.values else {}),
            **({"variables": dict(self.item.variables)} if self.item.variables else {}),
            "output": str(self.item.output),
            **({"outputs": [str(path) for path in files]} if files else {}),
            "status": str(self.status),
            "reason": str(self.reason),
        }
        if self.item.shot is not None:
            found["shot"] = self.item.shot.as_dict()
        if self.detail:
            found["detail"] = self.detail
        if self.status in {Status.DONE, Status.FAILED}:
            found["seconds"] = round(self.seconds, 6)
        if self.measured is not None:
            found["samples"] = self.measured.samples
            found["error"] = {
                "meters": self.measured.error,
                "joint": self.measured.joint,
            }
        if self.scores:
            found["scores"] = [one.as_dict() for one in self.scores]
        if self.faults:
            found["faults"] = [fault.as_dict() for fault in self.faults]
        if self.notices:
            found["notices"] = [notice.as_dict() for notice in self.notices]
        return found


@dataclass(frozen=True, slots=True)
class BatchReport:
    """What became of a batch."""

    batch: Batch  # the batch
    items: tuple[ItemReport, ...]  # those that were looked at, in order
    seconds: float  # wall time of all
    notices: tuple[Fault, ...] = ()  # warnings of the records of earlier runs

    def count(self, status: Status) -> int:
        """Return of how many items something became."""
        return sum(report.status is status for report in self.items)

    def reasons(self) -> Counter[Reason]:
        """Return how many items there are of each reason."""
        return Counter(report.reason for report in self.items)

    @property
    def failed(self) -> list[ItemReport]:
        """The items that failed, in order."""
        return [report for report in self.items if report.status is Status.FAILED]

    @property
    def slowest(self) -> list[ItemReport]:
        """The items that took longest, longest first."""
        made = [report for report in self.items if report.status is Status.DONE]
        return sorted(made, key=lambda report: -report.seconds)[:NAMED]

    @property
    def worst(self) -> list[ItemReport]:
        """The items whose files are farthest from their sources, farthest first."""
        measured = [report for report in self.items if _error(report) > 0]
        return sorted(measured, key=lambda report: -_error(report))[:NAMED]

    @property
    def scored(self) -> list[ItemReport]:
        """The items whose passes have scores, the worst first."""
        found = [report for report in self.items if report.scores]
        return sorted(found, key=lambda report: badness(report.scores), reverse=True)

    def warned(self) -> list[ItemReport]:
        """Return the items about which there are warnings."""
        return [
            report
            for report in self.items
            if any(n.severity is Severity.WARNING for n in report.notices)
        ]

    @property
    def exit_code(self) -> ExitCode:
        """What a process that ran the batch returns."""
        return ExitCode.FINDINGS if self.failed else ExitCode.OK

    def as_dict(self) -> dict[str, object]:
        """Return it as plain values."""
        return {
            "batch": "animtool/1",
            **{str(status).replace(" ", "_"): self.count(status) for status in Status},
            "seconds": round(self.seconds, 6),
            **(
                {"notices": [n.as_dict() for n in self.notices]} if self.notices else {}
            ),
            "items": [report.as_dict() for report in self.items],
        }


def _error(report: ItemReport) -> float:
    return 0.0 if report.measured is None else report.measured.error


def junit_report(reports: Sequence[ItemReport]) -> str:
    """Return a suite with a test case for each item."""
    return junit_xml("animtool batch", map(_case, reports))


def _case(report: ItemReport) -> JunitCase:
    name = str(report.item.output)
    odd = [n for n in report.notices if n.severity is not Severity.NOTE]
    said = "\n".join(map(str, odd))
    if report.status is Status.FAILED:
        first = report.faults[0]
        text = "\n".join(map(str, report.faults))
        return JunitCase(
            name, "failure", first.code, first.message, text, said, report.seconds
        )
    if report.status is Status.DONE:
        return JunitCase(name, said=said, seconds=report.seconds)
    return JunitCase(name, "skipped", message=str(report.reason))


EXECUTOR = "processes"


@dataclass(frozen=True, slots=True)
class RunOptions:
    """How a batch is run.

    Attributes:
        jobs: How many items are made at a time; None is as the batch says.
        executor: What makes them, and behind ``=`` what that is told.
        numbers: First and last item to look at; None is all.
        dry_run: Make nothing; say what would be.
        force: Make every item, also what is up to date.
        verify: Read every file again, whatever its size and time.
        retry_failed: Only what failed last time.
        most_failures: After so many, begin nothing more; None is never.
        overwrite: Replace files that no run of the batch made.
    """

    jobs: int | None = None
    executor: str = EXECUTOR
    numbers: tuple[int, int] | None = None
    dry_run: bool = False
    force: bool = False
    verify: bool = False
    retry_failed: bool = False
    most_failures: int | None = None
    overwrite: bool = False


class Listener:
    """Whom a run tells what happens; this one does nothing about it."""

    def planned(self, due: int, total: int) -> None:
        """Take how many of how many items are to be made."""

    def began(self, item: Item) -> None:
        """Take that an item is begun."""

    def ended(self, report: ItemReport) -> None:
        """Take what became of an item."""


def run_batch(
    spec: BatchSpec | Batch,
    options: RunOptions | None = None,
    listener: Listener | None = None,
) -> BatchReport:
    """Make what is not made yet of a batch, or no longer up to date.

    Args:
        spec: What is asked for.
        options: How.
        listener: Whom to tell.

    Raises:
        FormatError: A scene, or a record of an earlier run, is malformed.
        NothingFoundError: There is no input (BAT005).
        OptionError: Outputs clash (OUT007), are inputs (OUT003), or exist and were
            made by nobody here (OUT001); or an option makes no sense.
        OutputError: Another run goes on (BAT010), or a folder cannot be written to
            (OUT002, BAT012).
    """
    began = time.perf_counter()
    options, listener = options or RunOptions(), listener or Listener()
    batch = spec if isinstance(spec, Batch) else find_batch(spec)
    items = _chosen(batch, options)
    check_places(batch)
    if options.dry_run:
        history = read_history(batch.records, batch.name)
        planner = Planner(batch, history, verify=options.verify, force=options.force)
        chosen = _retried(items, options, planner, history)
        planned = [_planned(decision) for decision in planner.decisions(chosen)]
        seconds = time.perf_counter() - began
        return BatchReport(batch, tuple(planned), seconds, tuple(history.damaged))
    part = "" if options.numbers is None else "{}-{}".format(*options.numbers)
    with held_ledger(batch.records, batch.name, part) as ledger:
        run = _Run(batch, options, listener, ledger)
        run.plan(items)
        run.make()
        ledger.settle(run.wanted)
    seconds, damaged = time.perf_counter() - began, tuple(ledger.history.damaged)
    return BatchReport(batch, tuple(run.reports()), seconds, damaged)


def _chosen(batch: Batch, options: RunOptions) -> Sequence[Item]:
    if options.numbers is None:
        return batch.items
    first, last = options.numbers
    if not 1 <= first <= last <= len(batch.items):
        message = f"items {first} to {last} are not within 1 to {len(batch.items)}"
        raise OptionError(Fault("BAT033", message))
    return batch.items[first - 1 : last]


def _retried(
    items: Sequence[Item], options: RunOptions, planner: Planner, history: History
) -> Sequence[Item]:
    """Return the items that are looked at: all, or those that failed last time."""
    if not options.retry_failed:
        return items
    return [item for item in items if planner.key(item) in history.failed]


def _planned(decision: Decision) -> ItemReport:
    status = Status.NOT_RUN if decision.due else Status.SKIPPED
    return ItemReport(decision.item, status, decision.reason, decision.detail)


class _Run:
    """One run, while its records are held."""

    def __init__(
        self, batch: Batch, options: RunOptions, listener: Listener, ledger: Ledger
    ) -> None:
        self.batch, self.options = batch, options
        self.listener, self.ledger = listener, ledger
        self.planner = Planner(
            batch,
            ledger.history,
            now=ledger.now,
            verify=options.verify,
            force=options.force,
        )
        self.decisions: dict[int, Decision] = {}
        self.found: dict[int, ItemReport] = {}
        self.begun: set[int] = set()
        self.failures = 0

    def plan(self, items: Sequence[Item]) -> None:
        """Decide what is to be made, and check that it may be."""
        due: list[Item] = []
        chosen = _retried(items, self.options, self.planner, self.ledger.history)
        for decision in self.planner.decisions(chosen):
            item = decision.item
            self.decisions[item.number] = decision
            if decision.due:
                if not due:
                    self._executor()[0].get_ready(self.batch.recipe)
                due.append(item)
            if decision.refreshed is not None:
                self.ledger.made(decision.refreshed)
        self._tidy()
        if not self.options.overwrite:
            check_overwrites(self.batch, due, self._is_known)
        self.listener.planned(len(due), len(self.decisions))

    def _is_known(self, path: Path) -> bool:
        """Return whether a run of the batch made a file, or began to."""
        return named_from(path, self.batch.root) in self.ledger.history.made.known

    def _executor(self) -> tuple[Executor, str]:
        """Return what makes items, and what that is told."""
        name, _, argument = self.options.executor.partition("=")
        return find_executor(name), argument

    def _tidy(self) -> None:
        """Remove what killed runs began to write, also for items that are whole."""
        items = [decision.item for decision in self.decisions.values()]
        folders = dict.fromkeys(folder for item in items for folder in item.folders)
        folders[self.batch.records] = None
        remove_leftovers(folder.resolve() for folder in folders)

    def make(self) -> None:
        """Make what is due."""
        due = [d.item for d in self.decisions.values() if d.due]
        if not due:
            return
        executor, argument = self._executor()
        execute = executor.load()
        maker = Maker(self.batch.recipe, self.batch.root)
        asked = self.options.jobs or self.batch.jobs
        jobs = min(asked or _processors(), len(due))
        items = self._begun(due)
        work = Work(maker, items, self.batch.limits, jobs, argument, asked)
        outcomes = execute(work)
        close: Callable[[], None] = getattr(outcomes, "close", lambda: None)
        try:
            for outcome in outcomes:
                # Executors of plug-ins may yield anything.
                if isinstance(outcome, Outcome):
                    self._ended(outcome)
        finally:
            close()
        for number in sorted(self.begun - self.found.keys()):
            item = self.decisions[number].item
            message = "whatever made it has not said what became of it"
            fault = Fault("BAT020", message, str(item.found.path))
            self._ended(Outcome.failed(item, fault))
        # A process of a run that was killed may have lived a moment longer.
        self._tidy()

    def _begun(self, due: Sequence[Item]) -> Iterator[Item]:
        """Yield items, each when it is begun, unless too many have failed."""
        most = self.options.most_failures
        for item in due:
            if most is not None and self.failures >= most:
                return
            self.begun.add(item.number)
            paths = self.batch.outputs(item)
            if not self.options.overwrite:
                # Another batch, or a person, may have written it since the plan.
                try:
                    check_overwrites(self.batch, [item], self._is_known)
                except OptionError as error:
                    self._ended(Outcome.failed(item, *error.faults))
                    continue
            self.ledger.claim([named_from(path, self.batch.root) for path in paths])
            self.listener.began(item)
            yield item

    def _ended(self, outcome: Outcome) -> None:
        if outcome.number not in self.begun or outcome.number in self.found:
            # An executor of a plug-in said it twice, or of what it was not given.
            return
        decision = self.decisions[outcome.number]
        item = decision.item
        report = ItemReport.of(item, decision.reason, decision.detail, outcome)
        key = self.planner.key(item)
        if outcome.status is Status.DONE:
            self.ledger.made(
                ItemRecord(
                    key,
                    self.planner.how(item),
                    self.planner.versions,
                    outcome.inputs,
                    outcome.outputs,
                    outcome.at,
                )
            )
        else:
            self.failures += 1
            self.ledger.failed(key, report.why)
        self.found[item.number] = report
        self.listener.ended(report)

    def wanted(self, made: ItemRecord) -> bool:
        """Return whether a record is of interest: its output is there, or to be."""
        return any(
            place_of(file.path, self.batch.root).exists() for file in made.outputs
        )

    def reports(self) -> Iterator[ItemReport]:
        """Yield what became of every item that was looked at, in order."""
        for number, decision in self.decisions.items():
            yield self.found.get(number) or _planned(decision)


def _processors() -> int:
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:
        return os.cpu_count() or 1
