"""States that a simulation is resumed from, in an npz file."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from animtool.errors import Fault, FormatError, OptionError
from animtool.output import output_error, replacing
from animtool.sim.attach.stepping import State, nowhere

__all__ = ["Saved", "read_states", "write_states"]

FORMAT = "animtool-simulate/1"


@dataclass(frozen=True, slots=True, eq=False)
class Saved:
    """States of attachments at one frame.

    Attributes:
        frame: Its time code.
        steps: Of each attachment a frame.
        states: By the attachment's name.
    """

    frame: float
    steps: Mapping[str, int]
    states: Mapping[str, State]


def write_states(path: Path, saved: list[Saved]) -> None:
    """Write states in place of what a file held.

    Raises:
        OutputError: It cannot be written.
    """
    arrays: dict[str, Any] = {
        "format": np.array(FORMAT),
        "frames": np.array([one.frame for one in saved], np.float64),
    }
    for i, one in enumerate(saved):
        for name, state in one.states.items():
            both = np.stack([state.positions, state.velocities])
            arrays[f"{i}/{name}"] = both
            arrays[f"{i}/{name}/steps"] = np.array(float(one.steps[name]))
            if len(state.passages):
                arrays[f"{i}/{name}/passages"] = state.passages
    try:
        with replacing(path) as temporary, temporary.open("wb") as file:
            np.savez(file, **arrays)
    except OSError as error:
        raise output_error(path, error) from error


def read_states(path: Path, sizes: Mapping[str, int]) -> Saved:
    """Return the latest states of a file.

    Args:
        path: The file.
        sizes: Particles of each attachment, by name.

    Raises:
        FormatError: It cannot be read, or is none of states (SIM035).
        OptionError: It is of other attachments (SIM035).
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            if "format" not in file or str(file["format"]) != FORMAT:
                message = "is no file of states that simulate saved"
                raise FormatError(Fault("SIM035", message, str(path)))
            arrays = {name: file[name] for name in file.files}
    except (OSError, ValueError, zipfile.BadZipFile) as error:
        raise FormatError(Fault("SIM035", f"{error}", str(path))) from error
    frames = arrays["frames"].tolist()
    if not frames:
        raise OptionError(Fault("SIM035", "it has no state of any frame", str(path)))
    latest = max(range(len(frames)), key=lambda i: frames[i])
    states, steps, faults = {}, {}, []
    for name, size in sizes.items():
        found = arrays.get(f"{latest}/{name}")
        if found is None or found.shape != (2, size, 3):
            message = f"it has no state of {name!r} with {size} particles"
            faults.append(Fault("SIM035", message, str(path)))
            continue
        passages = arrays.get(f"{latest}/{name}/passages", nowhere())
        states[name] = State(found[0].copy(), found[1].copy(), passages)
        steps[name] = int(arrays[f"{latest}/{name}/steps"])
    if faults:
        raise OptionError(faults)
    return Saved(frames[latest], steps, states)
