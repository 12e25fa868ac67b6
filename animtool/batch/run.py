"""A run of a batch: plans, builds and records its items."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from animtool.batch.discover import Batch, find_batch
from animtool.batch.executors import Executor, Work, find_executor
from animtool.batch.item import Item
from animtool.batch.ledger import History, Ledger, locked_ledger, read_history
from animtool.batch.manifest import ItemRecord
from animtool.batch.plan import (
    BuildDecision,
    Planner,
    check_output_files,
    check_overwrites,
)
from animtool.batch.report import BatchReport, ItemReport
from animtool.batch.spec import BatchSpec, path_of_name, relative_name
from animtool.batch.work import ItemBuilder, ItemOutcome, ItemStatus
from animtool.core.errors import Fault, OptionError, excerpt
from animtool.core.files.leftovers import remove_leftovers
from animtool.core.loaded import check_loaded
from animtool.core.record import dataclass

DEFAULT_EXECUTOR = "processes"


@dataclass(frozen=True, slots=True)
class RunOptions:
    """Which items a batch run builds, where, and what it may overwrite.

    Attributes:
        jobs: Number of simultaneous items; None uses the batch's.
        executor: Name of the executor, with its argument after ``=``.
        numbers: First and last item; None for all.
        dry_run: Build nothing; report what would be built.
        force: Build every item, even if up to date.
        verify: Read every file again, whatever its size and time.
        retry_failed: Build only items that failed last time.
        max_failures: Start no more items after this many failures; None for no limit.
        overwrite: Replace files that no run of the batch wrote.
    """

    jobs: int | None = None
    executor: str = DEFAULT_EXECUTOR
    numbers: tuple[int, int] | None = None
    dry_run: bool = False
    force: bool = False
    verify: bool = False
    retry_failed: bool = False
    max_failures: int | None = None
    overwrite: bool = False

    def __post_init__(self) -> None:
        """Check the number of simultaneous items."""
        jobs = self.jobs
        if jobs is not None and (not isinstance(jobs, int) or jobs < 1):
            message = f"jobs is {excerpt(str(jobs))}: it is a whole number from 1 up, "
            message += "or None"
            raise OptionError(Fault("SCN025", message))


class RunListener:
    """Receives the events of a batch run; this base class ignores them.

    Attributes:
        shown_warnings: Warnings that were already displayed.
    """

    shown_warnings: tuple[Fault, ...] = ()

    def on_plan(self, due_count: int, total_count: int) -> None:
        """Handle the plan: the number of items to build, and of all items."""

    def on_start(self, item: Item) -> None:
        """Handle the start of an item."""

    def on_end(self, report: ItemReport) -> None:
        """Handle the outcome of an item."""

    def on_warning(self, notice: Fault) -> None:
        """Handle a warning about an executor."""


def run_batch(
    spec: BatchSpec | Batch,
    options: RunOptions | None = None,
    listener: RunListener | None = None,
) -> BatchReport:
    """Build the missing and outdated items of a batch.

    Args:
        spec: The batch.
        options: Run options.
        listener: Receives events.

    Raises:
        FormatError: A scene, or a record of an earlier run, is malformed.
        NoMatchError: There is no input (BAT005).
        OptionError: Outputs are equal (OUT007), are inputs (OUT003), or exist without
            a record of the batch (OUT001); or an option is invalid.
        LockedError: Another run is active (BAT010).
        OutputError: A folder cannot be written to (OUT002, BAT012).
    """
    if not isinstance(spec, Batch):
        check_loaded(spec, BatchSpec, "spec")
    start_time = time.perf_counter()
    options, listener = options or RunOptions(), listener or RunListener()
    batch = spec if isinstance(spec, Batch) else find_batch(spec)
    items = _selected_items(batch, options)
    check_output_files(batch)
    if options.dry_run:
        history = read_history(batch.records_folder, batch.name)
        planner = Planner(
            batch, history, rehashes_files=options.verify, builds_all=options.force
        )
        decisions = _decisions(items, options, planner, history)
        reports = tuple(map(_planned_report, decisions))
        seconds = time.perf_counter() - start_time
        return BatchReport(batch, reports, seconds, tuple(history.damage_warnings))
    part_name = "" if options.numbers is None else "{}-{}".format(*options.numbers)
    with locked_ledger(batch.records_folder, batch.name, part_name) as ledger:
        run = _BatchRun(batch, options, listener, ledger)
        run.plan(items)
        run.build_due_items()
        ledger.merge_records(run.should_keep)
    seconds = time.perf_counter() - start_time
    notices = (*ledger.history.damage_warnings, *run.notices)
    return BatchReport(batch, tuple(run.reports()), seconds, notices)


def _selected_items(batch: Batch, options: RunOptions) -> Sequence[Item]:
    """Return the items in the requested range of numbers, else all."""
    if options.numbers is None:
        return batch.items
    first_number, last_number = options.numbers
    if not 1 <= first_number <= last_number <= len(batch.items):
        message = f"items {first_number} to {last_number} are not within 1 to "
        raise OptionError(Fault("BAT033", f"{message}{len(batch.items)}"))
    return batch.items[first_number - 1 : last_number]


def _decisions(
    items: Sequence[Item], options: RunOptions, planner: Planner, history: History
) -> Iterator[BuildDecision]:
    """Yield the decision for each item, or only for those that failed last time."""
    for item in items:
        if (
            not options.retry_failed
            or planner.record_key(item) in history.failure_reasons
        ):
            yield planner.decide(item)


def _planned_report(decision: BuildDecision) -> ItemReport:
    status = ItemStatus.NOT_RUN if decision.is_due else ItemStatus.SKIPPED
    return ItemReport(
        decision.item, status, decision.reason, decision.detail, scores=decision.scores
    )


class _BatchRun:
    """A run of a batch: its plan, its outcomes and the ledger that it locks."""

    def __init__(
        self, batch: Batch, options: RunOptions, listener: RunListener, ledger: Ledger
    ) -> None:
        self.batch, self.options = batch, options
        self.listener, self.ledger = listener, ledger
        self.planner = Planner(
            batch,
            ledger.history,
            current_time_ns=ledger.start_time_ns,
            rehashes_files=options.verify,
            builds_all=options.force,
        )
        self.decisions: dict[int, BuildDecision] = {}
        self.reports_by_number: dict[int, ItemReport] = {}
        self.started_numbers: set[int] = set()
        self.failure_count = 0
        self.notices: list[Fault] = []  # warnings about workers

    def plan(self, items: Sequence[Item]) -> None:
        """Decide which items to build, and check their outputs."""
        due_items: list[Item] = []
        history = self.ledger.history
        for decision in _decisions(items, self.options, self.planner, history):
            item = decision.item
            self.decisions[item.number] = decision
            if decision.is_due:
                if not due_items:
                    self._executor()[0].prepare(self.batch.item_task)
                due_items.append(item)
            if decision.updated_record is not None:
                self.ledger.add(decision.updated_record)
        self._remove_temporary_files()
        if not self.options.overwrite:
            check_overwrites(self.batch, due_items, self._is_known)
        self.listener.on_plan(len(due_items), len(self.decisions))

    def _is_known(self, path: Path) -> bool:
        """Return whether a run of the batch wrote a file, or started to."""
        name = relative_name(path, self.batch.root)
        return name in self.ledger.history.manifest.known_names

    def _executor(self) -> tuple[Executor, str]:
        """Return the executor of the run, and the text after its name and ``=``."""
        name, _, executor_argument = self.options.executor.partition("=")
        return find_executor(name), executor_argument

    def _remove_temporary_files(self) -> None:
        """Remove temporary files of killed runs, also for intact items."""
        items = [decision.item for decision in self.decisions.values()]
        folders = dict.fromkeys(folder for item in items for folder in item.folders)
        folders[self.batch.records_folder] = None
        remove_leftovers(folder.resolve() for folder in folders)

    def build_due_items(self) -> None:
        """Build the items that are due with the executor, and record each outcome."""
        batch, decisions = self.batch, self.decisions.values()
        due_items = [decision.item for decision in decisions if decision.is_due]
        if not due_items:
            return
        executor, executor_argument = self._executor()
        run_executor = executor.load()
        requested_jobs = self.options.jobs or batch.jobs
        work = Work(
            ItemBuilder(batch.item_task, batch.root),
            self._start_items(due_items),
            batch.limits,
            min(requested_jobs or _processor_count(), len(due_items)),
            executor_argument,
            requested_jobs,
            (*batch.shared_inputs, *(item.file.path for item in due_items)),
            (
                batch.records_folder,
                *dict.fromkeys(f for i in due_items for f in i.folders),
            ),
            self.options.max_failures is None,
        )
        outcomes = run_executor(work)
        close_outcomes: Callable[[], None] = getattr(outcomes, "close", lambda: None)
        try:
            for outcome in outcomes:
                # Executors of plug-ins may yield anything.
                if isinstance(outcome, ItemOutcome):
                    self._record_outcome(outcome)
                elif isinstance(outcome, Fault):
                    self.notices.append(outcome)
                    self.listener.on_warning(outcome)
        finally:
            close_outcomes()
        for number in sorted(self.started_numbers - self.reports_by_number.keys()):
            item = self.decisions[number].item
            message = "the process that built it did not report a result"
            fault = Fault("BAT020", message, str(item.file.path))
            self._record_outcome(ItemOutcome.failed(item, fault))
        # A process of a killed run may have lived a moment longer.
        self._remove_temporary_files()

    def _start_items(self, due_items: Sequence[Item]) -> Iterator[Item]:
        """Yield items as they are started; stop after too many failures."""
        max_failures = self.options.max_failures
        for item in due_items:
            if max_failures is not None and self.failure_count >= max_failures:
                return
            self.started_numbers.add(item.number)
            paths = self.batch.outputs(item)
            if not self.options.overwrite:
                # Another batch, or a person, may have written it since planning.
                try:
                    check_overwrites(self.batch, [item], self._is_known)
                except OptionError as error:
                    self._record_outcome(ItemOutcome.failed(item, *error.faults))
                    continue
            self.ledger.add_names(
                [relative_name(path, self.batch.root) for path in paths]
            )
            self.listener.on_start(item)
            yield item

    def _record_outcome(self, outcome: ItemOutcome) -> None:
        """Add an outcome to the reports, and to the ledger if the item is built."""
        pending_numbers = self.started_numbers - self.reports_by_number.keys()
        if outcome.number not in pending_numbers:
            # A plug-in's executor reported it twice, or reported an unknown item.
            return
        decision = self.decisions[outcome.number]
        item = decision.item
        report = replace(
            _planned_report(decision),
            status=outcome.status,
            seconds=outcome.seconds,
            faults=outcome.faults,
            notices=outcome.notices,
            measurements=outcome.measurements,
            scores=outcome.scores,
        )
        key = self.planner.record_key(item)
        if outcome.status is ItemStatus.DONE:
            self.ledger.add(
                ItemRecord(
                    key,
                    self.planner.settings_digest(item),
                    self.planner.versions,
                    outcome.inputs,
                    outcome.outputs,
                    outcome.written_at,
                    outcome.scores,
                )
            )
        else:
            self.failure_count += 1
            self.ledger.add_failure(key, report.failure_text)
        self.reports_by_number[item.number] = report
        self.listener.on_end(report)

    def should_keep(self, record: ItemRecord) -> bool:
        """Return whether any output of a recorded item exists."""
        paths = (path_of_name(file.path, self.batch.root) for file in record.outputs)
        return any(path.exists() for path in paths)

    def reports(self) -> Iterator[ItemReport]:
        """Yield the report of every considered item, in order."""
        for number, decision in self.decisions.items():
            yield self.reports_by_number.get(number) or _planned_report(decision)


def _processor_count() -> int:
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:
        return os.cpu_count() or 1
