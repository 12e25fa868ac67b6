"""Files that another machine built, compared with local copies."""

from __future__ import annotations

import os
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import field, replace
from pathlib import Path

from animtool.batch.manifest import FileRecord, file_digest
from animtool.batch.spec import path_of_name
from animtool.batch.work import ItemOutcome
from animtool.core.errors import AnimtoolError
from animtool.core.files.reading import FileState
from animtool.core.record import dataclass


@dataclass(slots=True)
class Delivery:
    """Local state of files, each read once while it is unchanged."""

    root: Path  # folder from which records name files
    # What inputs were when they were first looked at.
    _states: dict[Path, FileState | None] = field(default_factory=dict)
    _digests: dict[Path, tuple[FileState, str]] = field(default_factory=dict)

    def note(self, path: Path) -> FileState | None:
        """Return the first recorded state of an input."""
        where = path.absolute()
        if where not in self._states:
            self._states[where] = FileState.of(where)
        return self._states[where]

    def other_inputs(self, outcome: ItemOutcome) -> list[Path]:
        """Return the inputs whose local content differs from an item's."""
        paths = [(path_of_name(one.path, self.root), one) for one in outcome.inputs]
        return [path for path, one in paths if not self._is_same(path, one)]

    def changed(self, paths: Iterable[Path]) -> list[Path]:
        """Return the inputs that changed locally since their first record."""
        return [path for path in paths if self.note(path) != FileState.of(path)]

    def delivered(self, outcome: ItemOutcome) -> ItemOutcome | None:
        """Return an outcome with its local outputs; None until they match.

        They are looked up afresh: a network disk may remember for a minute that a file
        was missing.
        """
        outputs = []
        for folder in dict.fromkeys(
            path_of_name(one.path, self.root).parent for one in outcome.outputs
        ):
            with suppress(OSError), os.scandir(folder):
                pass
        for one in outcome.outputs:
            path = path_of_name(one.path, self.root)
            state = FileState.of(path)
            if state is None or not self._is_same(path, one):
                return None
            outputs.append(replace(one, state=state))
        at = max((one.state.changed for one in outputs if one.state), default=0)
        return replace(outcome, outputs=tuple(outputs), at=at)

    def _is_same(self, path: Path, record: FileRecord) -> bool:
        state = FileState.of(path)
        self._states.setdefault(path, state)
        if state is None or record.state is None:
            return state is record.state
        return not record.sha256 or self._digest(path, state) == record.sha256

    def _digest(self, path: Path, state: FileState) -> str:
        known = self._digests.get(path)
        if known is None or known[0] != state:
            try:
                self._digests[path] = known = state, file_digest(path)
            except (AnimtoolError, OSError):
                return "unreadable"
        return known[1]
