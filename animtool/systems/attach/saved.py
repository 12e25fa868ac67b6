"""States that a simulation is resumed from, in an npz file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from animtool._types import FloatArray
from animtool.documents.arrays import Archives
from animtool.errors import Fault, OptionError
from animtool.systems.attach.stepping import State, nowhere
from animtool.systems.saved import open_saved, write_saved

FORMAT = "animtool-simulate/1"
# What a simulation of any size has.
MAX_STEPS = 1_000_000
MAX_INDEX = 1 << 31


@dataclass(frozen=True, slots=True, eq=False)
class Saved:
    """States of attachments at one frame."""

    frame: float  # its time code
    steps: Mapping[str, int]  # of each attachment a frame
    states: Mapping[str, State]  # by the attachment's name


def write_states(path: Path, saved: list[Saved]) -> None:
    """Write states in place of what a file held.

    Raises:
        OutputError: It cannot be written.
    """
    arrays: dict[str, Any] = {
        "frames": np.array([one.frame for one in saved], np.float64)
    }
    for i, one in enumerate(saved):
        for name, state in one.states.items():
            both = np.stack([state.positions, state.velocities])
            arrays[f"{i}/{name}"] = both
            arrays[f"{i}/{name}/steps"] = np.array(float(one.steps[name]))
            if len(state.passages):
                arrays[f"{i}/{name}/passages"] = state.passages
    write_saved(path, FORMAT, arrays)


def read_states(path: Path, sizes: Mapping[str, int]) -> Saved:
    """Return the latest states of a file, of attachments of so many particles.

    Raises:
        FormatError: It cannot be read, or is none of states (SIM035).
        OptionError: It is of other attachments (SIM035).
    """
    with open_saved(path, FORMAT, "states that simulate") as archives:
        return _latest(_SavedArrays(path, archives), sizes)


@dataclass(frozen=True, slots=True)
class _SavedArrays:
    """The arrays of a file of states."""

    path: Path
    archives: Archives

    def load(self, name: str, shape: tuple[int | None, ...]) -> FloatArray:
        """Return an array of finite numbers.

        Raises:
            ValueError: There is none, or its shape is another; None is any length.
        """
        values = self.archives.load(self.path, name)
        fits = len(values.shape) == len(shape) and all(
            want in (None, n) for want, n in zip(shape, values.shape, strict=True)
        )
        if not fits:
            raise ValueError(f"{name} has shape {values.shape}")
        return values

    def has(self, name: str) -> bool:
        return self.archives.has(self.path, name)


def _latest(arrays: _SavedArrays, sizes: Mapping[str, int]) -> Saved:
    """Return the states of the latest frame; see `read_states`."""
    path = str(arrays.path)
    frames = arrays.load("frames", (None,)).tolist()
    if not frames:
        raise OptionError(Fault("SIM035", "it has no state of any frame", path))
    latest = max(range(len(frames)), key=lambda i: frames[i])
    states, steps, faults = {}, {}, []
    for name, size in sizes.items():
        key = f"{latest}/{name}"
        try:
            found = arrays.load(key, (2, size, 3))
            count = float(arrays.load(f"{key}/steps", ()))
        except ValueError as error:
            message = f"it has no state of {name!r} with {size} particles"
            faults.append(Fault("SIM035", message, path, (), str(error)))
            continue
        if not 1 <= count <= MAX_STEPS:
            message = f"{key}/steps is {count:g}"
            faults.append(Fault("SIM035", message, path))
            continue
        passages = nowhere()
        if arrays.has(f"{key}/passages"):
            stored = arrays.load(f"{key}/passages", (None, passages.shape[1]))
            if (np.abs(stored) > MAX_INDEX).any() or (stored[:, 0] >= size).any():
                message = f"{key}/passages has an index that no cloth has"
                faults.append(Fault("SIM035", message, path))
                continue
            passages = stored.astype(np.int64)
        states[name] = State(found[0].copy(), found[1].copy(), passages)
        steps[name] = int(count)
    if faults:
        raise OptionError(faults)
    return Saved(frames[latest], steps, states)
