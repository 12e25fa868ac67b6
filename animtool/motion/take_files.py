"""A take as the files of a format, made but not written."""

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

# Bytes to write one after another, or the arrays of an npz by name.
Contents: TypeAlias = "Iterable[bytes] | Mapping[str, npt.NDArray[np.generic]]"


@dataclass(frozen=True, slots=True)
class WriteOptions:
    """What a writer of files is told."""

    # How far keys may move a joint, or a point 3 cm off it [m]; None is the usual.
    tolerance: float | None = None
    # Other tolerances for some joints: names or patterns, and [m].
    joint_tolerances: Mapping[str, float] = field(default_factory=dict)
    # What an additive take is put on, at its frames.
    base: Take | None = None
    rig_file: Path | None = None  # with the take's rig, to be named; None writes one
    others: tuple[
        Take, ...
    ] = ()  # further takes of the rig, where a file holds several
    names: tuple[str, ...] = ()  # of all takes; empty is the name of the file


@dataclass(frozen=True, slots=True)
class TakeFiles:
    """The files of a take, the one that was asked for last."""

    contents: dict[Path, Contents]  # by file, in the order to write them
    span: FrameSpan  # first frame, last frame and rate, as the file has them
    joints: int
    notices: list[Fault]  # what the format cannot hold
    # The keys, and how far they are off, where such are fitted.
    keyed: Any = None
