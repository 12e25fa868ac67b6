"""The contents of a take's output files, before writing."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import field
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from animtool.core.clock import FrameSpan
from animtool.core.errors import Fault
from animtool.core.record import dataclass
from animtool.motion.take import Take

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

# Chunks of bytes to write in order, or the arrays of an npz by name.
Contents: TypeAlias = "Iterable[bytes] | Mapping[str, npt.NDArray[np.generic]]"


@dataclass(frozen=True, slots=True)
class WriteOptions:
    """Options of a file writer."""

    # Tolerance of fitted keys, at the joint and 3 cm from it [m]; None: the default.
    tolerance: float | None = None
    # Tolerances of individual joints [m], by name or pattern.
    joint_tolerances: Mapping[str, float] = field(default_factory=dict)
    # Base of an additive take, at the same frames.
    base: Take | None = None
    rig_file: Path | None = None  # existing rig file to refer to; None writes one
    others: tuple[Take, ...] = ()  # further takes of the rig in the same file
    names: tuple[str, ...] = ()  # of all takes; empty uses the file name


@dataclass(frozen=True, slots=True)
class TakeFiles:
    """All files of a take; the requested file last."""

    contents: dict[Path, Contents]  # by file, in the order to write them
    span: FrameSpan  # first frame, last frame and rate, as the file has them
    joints: int
    notices: list[Fault]  # data that the format cannot store
    # Fitted keys and their errors, if any.
    keyed: Any = None
