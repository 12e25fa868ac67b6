"""The plan of a batch: the items to build, the reasons, and the refused outputs."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from enum import StrEnum
from functools import cached_property
from pathlib import Path

from animtool.batch.discover import Batch
from animtool.batch.item import Item, input_values
from animtool.batch.ledger import History
from animtool.batch.manifest import FileRecord, ItemRecord, digest_of, file_digest
from animtool.batch.spec import package_versions, path_of_name, relative_name
from animtool.core.arguments import argument
from animtool.core.errors import (
    Fault,
    FormatError,
    OptionError,
    OutputError,
    first_faults,
)
from animtool.core.files.commit import WRITE_HINT
from animtool.core.files.output import name_key
from animtool.core.files.reading import FileState, PathResolver
from animtool.core.record import dataclass
from animtool.motion.scores import PassScores


class BuildReason(StrEnum):
    """Reason for building or skipping an item."""

    NEW = "new"
    INPUT = "input changed"
    OPTIONS = "options changed"
    VERSION = "version changed"
    OUTPUT = "output changed"
    FAILED = "failed last time"
    FORCED = "asked for"
    UP_TO_DATE = "up to date"


@dataclass(frozen=True, slots=True)
class BuildDecision:
    """Whether to build an item, and the reason."""

    item: Item
    reason: BuildReason
    detail: str = ""  # the changed file, or the last failure
    # The item's record with updated file states, if files were touched but have the
    # same content.
    updated_record: ItemRecord | None = None
    scores: tuple[PassScores, ...] = ()  # scores of an up-to-date item, from its record

    @property
    def is_due(self) -> bool:
        """Whether to build the item."""
        return self.reason is not BuildReason.UP_TO_DATE


class Planner:
    """Decides which items to build, by records of earlier runs and current files.

    A file is hashed only if its size, time or inode changed, or if it is as young as
    the record, since it may then have changed without a different state.
    """

    def __init__(
        self,
        batch: Batch,
        history: History,
        *,
        current_time_ns: int = 0,
        rehashes_files: bool = False,
        builds_all: bool = False,
    ) -> None:
        """Create a planner; the time is that of the disk with the records [ns]."""
        self._batch = batch
        self._history = history
        self._current_time_ns = current_time_ns
        self._rehashes_files, self._builds_all = rehashes_files, builds_all
        self._states_by_path: dict[str, FileState | None] = {}
        self._digests_by_path: dict[str, str] = {}

    def record_key(self, item: Item) -> str:
        """Return the key of an item's record: its output, relative to the root."""
        return relative_name(item.output, self._batch.root)

    def settings_digest(self, item: Item) -> str:
        """Return a digest of all settings that affect how an item is built."""
        return digest_of(self._batch.item_task.settings(item, self._batch.root))

    @cached_property
    def versions(self) -> str:
        """Digest of the versions of the packages that build items."""
        return digest_of(package_versions())

    def decide(self, item: Item) -> BuildDecision:
        """Return whether to build an item, and why: what changed since the last run."""
        key = self.record_key(item)
        record = self._history.manifest.items.get(key)
        failure_reason = self._history.failure_reasons.get(key)
        if self._builds_all:
            return BuildDecision(item, BuildReason.FORCED)
        if record is None:
            if failure_reason is not None:
                return BuildDecision(item, BuildReason.FAILED, failure_reason)
            return BuildDecision(item, BuildReason.NEW)
        decision = self._decide_by_record(item, record)
        if decision.is_due and failure_reason is not None:
            return BuildDecision(item, BuildReason.FAILED, failure_reason)
        return decision

    def _decide_by_record(self, item: Item, record: ItemRecord) -> BuildDecision:
        if record.settings_digest != self.settings_digest(item):
            return BuildDecision(item, BuildReason.OPTIONS)
        if record.versions != self.versions:
            return BuildDecision(item, BuildReason.VERSION)
        inputs: list[FileRecord] = []
        outputs: list[FileRecord] = []
        for reason, files, unchanged_records in (
            (BuildReason.INPUT, record.inputs, inputs),
            (BuildReason.OUTPUT, record.outputs, outputs),
        ):
            for file in files:
                # A file as young as the record may have changed after it without a
                # different state.
                state = file.state if reason is BuildReason.INPUT else None
                is_young = state is not None and state.changed_at >= record.written_at
                current_record = self._unchanged_record(file, is_young=is_young)
                if current_record is None:
                    return BuildDecision(item, reason, file.path)
                unchanged_records.append(current_record)
        updated_record: ItemRecord | None = None
        if (tuple(inputs), tuple(outputs)) != (record.inputs, record.outputs):
            updated_record = replace(
                record,
                inputs=tuple(inputs),
                outputs=tuple(outputs),
                written_at=self._current_time_ns,
            )
        return BuildDecision(
            item, BuildReason.UP_TO_DATE, "", updated_record, record.scores
        )

    def _unchanged_record(
        self, file: FileRecord, *, is_young: bool
    ) -> FileRecord | None:
        """Return the current record of a file; None if its content differs."""
        if file.path not in self._states_by_path:
            path = path_of_name(file.path, self._batch.root)
            self._states_by_path[file.path] = FileState.of(path)
        state = self._states_by_path[file.path]
        if state is None or file.state is None:
            return file if state is file.state else None
        if state == file.state and not is_young and not self._rehashes_files:
            return file
        if state.size != file.state.size or self._digest(file.path) != file.sha256:
            return None
        return replace(file, state=state)

    def _digest(self, path: str) -> str:
        if path not in self._digests_by_path:
            try:
                self._digests_by_path[path] = file_digest(
                    path_of_name(path, self._batch.root)
                )
            except FormatError:
                # Building the item reports why it cannot be read.
                self._digests_by_path[path] = "unreadable"
        return self._digests_by_path[path]


MAX_FAULTS = 50


def check_output_files(batch: Batch) -> None:
    """Raise an error for outputs that are equal (OUT007), inputs or unwritable.

    Names that differ only in case or in the encoding of accents are the same file on
    some disks.
    """
    resolve_path = PathResolver()
    inputs = {resolve_path(item.file.path) for item in batch.items}
    inputs |= {resolve_path(path) for path in batch.shared_inputs}
    faults = list(_output_clashes(batch, resolve_path, inputs))
    _raise_if_any(faults, OptionError)
    folders = dict.fromkeys(folder for item in batch.items for folder in item.folders)
    _raise_if_any(list(_unwritable_folders(folders)), OutputError)


def _output_clashes(
    batch: Batch, resolve_path: Callable[[Path], Path], inputs: set[Path]
) -> Iterator[Fault]:
    """Yield a fault for each output that is an input or is written twice."""
    writers_by_file: dict[str, list[tuple[Item, Path]]] = {}
    for item in batch.items:
        item_file_keys: set[str] = set()
        for path in batch.outputs(item):
            resolved_path = resolve_path(path)
            if resolved_path in inputs:
                message = "is an input of this batch"
                hint = f"choose another {argument('output')}"
                yield Fault("OUT003", message, str(path), (), hint)
            file_key = name_key(resolved_path)
            if file_key in item_file_keys:
                message = f"would be written twice for {item.label}"
                yield Fault("OUT007", message, str(path))
            else:
                writers_by_file.setdefault(file_key, []).append((item, path))
            item_file_keys.add(file_key)
    for (first_item, _), *other_writers in writers_by_file.values():
        if other_writers:
            second_item, path = other_writers[0]
            labels_text = f"{first_item.label} and {second_item.label}"
            message = f"would be written for both {labels_text}"
            if len(other_writers) > 1:
                message += f", and for {len(other_writers) - 1} more"
            hint = _separating_hint(second_item, first_item, batch.items)
            yield Fault("OUT007", message, str(path), (), hint)


def _separating_hint(item: Item, other_item: Item, items: Sequence[Item]) -> str:
    """Return a hint with a name that makes the outputs of two items distinct.

    Names that make those of all ``items`` distinct are preferred.
    """
    if item.shot is not None and item.shot != other_item.shot:
        return "use {shot} in the output to keep the shots separate"
    if item.file != other_item.file:
        input_value_by_name = input_values(item.file)
        other_value_by_name = input_values(other_item.file)
        all_input_values = [input_values(batch_item.file) for batch_item in items]
        stems = {values["stem"] for values in all_input_values}
        parents_and_stems = {
            (values["parent"], values["stem"]) for values in all_input_values
        }
        if len(stems) < len(items) == len(parents_and_stems):
            return "use {parent}/{stem} in the output to keep the inputs separate"
        for name in ("stem", "parent", "name"):
            if input_value_by_name[name] != other_value_by_name[name]:
                return f"use {{{name}}} in the output to keep the inputs separate"
    for name, value in item.variant_values.items():
        if other_item.variant_values.get(name) != value:
            return f"use {{{name}}} in the output to keep the variants separate"
    return "these values appear twice: remove one"


def _unwritable_folders(folders: Iterable[Path]) -> Iterator[Fault]:
    """Yield a fault for each folder that is not writable."""
    checked_folders: set[Path] = set()
    for folder in folders:
        existing_folders = (path for path in (folder, *folder.parents) if path.exists())
        existing_folder = next(existing_folders, Path())
        if existing_folder in checked_folders:
            continue
        checked_folders.add(existing_folder)
        reason = None
        if not existing_folder.is_dir():
            reason = "it is not a folder"
        elif not os.access(existing_folder, os.W_OK | os.X_OK):
            reason = "no permission"
        if reason is not None:
            message = f"cannot be written to: {reason}"
            hint = f"choose another {argument('output')}"
            hint = WRITE_HINT if reason == "no permission" else hint
            yield Fault("OUT002", message, str(existing_folder), (), hint)


def check_overwrites(
    batch: Batch, items: Iterable[Item], is_known: Callable[[Path], bool]
) -> None:
    """Raise an error for existing outputs that no run of the batch wrote."""
    hint = f"{argument('overwrite', True)} replaces it"
    faults = [
        Fault("OUT001", "already exists", str(path), (), hint)
        for item in items
        for path in batch.outputs(item)
        if path.exists() and not is_known(path)
    ]
    _raise_if_any(faults, OptionError)


def _raise_if_any(
    faults: list[Fault], error_type: type[OptionError] | type[OutputError]
) -> None:
    if faults:
        raise error_type(first_faults(faults, MAX_FAULTS))
