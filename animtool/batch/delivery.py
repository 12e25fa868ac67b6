"""Checks that files written on another machine have arrived."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import field, replace
from pathlib import Path

from animtool.batch.cluster_worker import InputCheck
from animtool.batch.manifest import FileRecord, file_digest
from animtool.batch.spec import path_of_name
from animtool.batch.work import ItemOutcome
from animtool.core.errors import AnimtoolError
from animtool.core.files.reading import FileState
from animtool.core.record import dataclass

# If there are more inputs, only every n-th is checked.
MAX_CHECKED_INPUTS = 10_000
# Larger inputs are not compared by content before the first item [bytes].
MAX_COMPARED_BYTES = 10_000_000


@dataclass(slots=True)
class Delivery:
    """Compares the inputs and outputs of other machines with local files."""

    root: Path  # root of the paths in records
    # State of inputs at their first access.
    _first_states_by_path: dict[Path, FileState | None] = field(default_factory=dict)
    _digests_by_path: dict[Path, tuple[FileState, str]] = field(default_factory=dict)

    def first_state(self, path: Path) -> FileState | None:
        """Return the state of an input when it was first recorded."""
        absolute_path = path.absolute()
        if absolute_path not in self._first_states_by_path:
            self._first_states_by_path[absolute_path] = FileState.of(absolute_path)
        return self._first_states_by_path[absolute_path]

    def input_checks(self, inputs: Iterable[Path]) -> Iterator[InputCheck]:
        """Yield the inputs that a worker must see; every n-th one if there are many."""
        paths = list(dict.fromkeys(path.absolute() for path in inputs))
        for path in paths[:: -(-len(paths) // MAX_CHECKED_INPUTS) or 1]:
            state = self.first_state(path)
            if state is not None and path.is_file():
                is_compared = (
                    state.size <= MAX_COMPARED_BYTES
                    and len(paths) <= MAX_CHECKED_INPUTS
                )
                with suppress(AnimtoolError, OSError):
                    digest = file_digest(path) if is_compared else ""
                    yield InputCheck(str(path), state.size, digest)

    def inputs_that_differ(self, outcome: ItemOutcome) -> list[Path]:
        """Return the inputs whose local content differs from what the item read."""
        paths_and_records = [
            (path_of_name(record.path, self.root), record) for record in outcome.inputs
        ]
        return [
            path
            for path, record in paths_and_records
            if not self._matches_record(path, record)
        ]

    def locally_changed(self, paths: Iterable[Path]) -> list[Path]:
        """Return the inputs that changed locally since they were first recorded."""
        return [path for path in paths if self.first_state(path) != FileState.of(path)]

    def with_local_outputs(self, outcome: ItemOutcome) -> ItemOutcome | None:
        """Return an outcome with the local output states; None until the files match.

        The state is read again each time, since a network disk may remember for a
        minute that a file was missing.
        """
        outputs = []
        for folder in dict.fromkeys(
            path_of_name(record.path, self.root).parent for record in outcome.outputs
        ):
            with suppress(OSError), os.scandir(folder):
                pass
        for record in outcome.outputs:
            path = path_of_name(record.path, self.root)
            state = FileState.of(path)
            if state is None or not self._matches_record(path, record):
                return None
            outputs.append(replace(record, state=state))
        written_at = max(
            (record.state.changed_at for record in outputs if record.state), default=0
        )
        return replace(outcome, outputs=tuple(outputs), written_at=written_at)

    def _matches_record(self, path: Path, record: FileRecord) -> bool:
        state = FileState.of(path)
        self._first_states_by_path.setdefault(path, state)
        if state is None or record.state is None:
            return state is record.state
        return not record.sha256 or self._digest(path, state) == record.sha256

    def _digest(self, path: Path, state: FileState) -> str:
        cached_digest = self._digests_by_path.get(path)
        if cached_digest is None or cached_digest[0] != state:
            try:
                self._digests_by_path[path] = cached_digest = state, file_digest(path)
            except (AnimtoolError, OSError):
                return "unreadable"
        return cached_digest[1]
