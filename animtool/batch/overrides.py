"""Variables that a batch sets for the inputs that match patterns."""

from __future__ import annotations

import os
from collections.abc import Collection, Mapping, Sequence
from dataclasses import field, replace
from pathlib import Path

from animtool.core.errors import Fault, Severity, listed
from animtool.core.files.reading import MatchedFile, PathResolver, matching_files
from animtool.core.record import dataclass


@dataclass(frozen=True, slots=True)
class Override:
    """Values of variables for the inputs that match any of the patterns.

    Attributes:
        inputs: Files, folders and globs, relative to the folder of the batch.
        variables: Values by name.
    """

    inputs: tuple[str, ...]
    variables: Mapping[str, str] = field(default_factory=dict)

    def without(self, names: Collection[str]) -> Override:
        """Return a copy without the values of the given names."""
        remaining = {
            name: value for name, value in self.variables.items() if name not in names
        }
        return replace(self, variables=remaining)


@dataclass(frozen=True, slots=True)
class OverriddenVariables:
    """Values of overridden variables by input of a batch."""

    values: Mapping[Path, Mapping[str, str]]  # by file path
    notices: tuple[Fault, ...]  # warnings about overrides that match no input


def resolve_overrides(
    overrides: Sequence[Override],
    files: Sequence[MatchedFile],
    folder: Path,
    suffixes: Sequence[str],
    path: Path | None,
) -> OverriddenVariables:
    """Return the overridden variables of inputs; the last match wins.

    Args:
        overrides: Overrides in order of precedence, last wins.
        files: The inputs.
        folder: Base folder of relative inputs.
        suffixes: Suffixes of inputs.
        path: The batch file.
    """
    resolve = PathResolver()
    path_by_location = {resolve(file.path): file.path for file in files}
    values: dict[Path, dict[str, str]] = {}
    notices = []
    for i, override in enumerate(overrides):
        matched_paths = {
            resolve(file.path)
            for text in override.inputs
            for file in matching_files(os.fspath(folder / text), suffixes)
        }
        locations = [
            path_by_location[location]
            for location in matched_paths
            if location in path_by_location
        ]
        for input_path in locations:
            values.setdefault(input_path, {}).update(override.variables)
        if not locations:
            message = f"no input of the batch is {listed(override.inputs)}"
            hint = "inputs are files, folders and globs, relative to the batch file"
            file = None if path is None else str(path)
            location = f"overrides[{i}].inputs"
            warning = Severity.WARNING
            notices.append(
                Fault("BAT066", message, file, (), hint, warning, where=location)
            )
    return OverriddenVariables(values, tuple(notices))
