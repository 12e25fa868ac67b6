"""Tracks of rigid things beside a rig: props, cameras, and values of attributes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from animtool.core.array_types import BoolArray, FloatArray
from animtool.core.errors import Fault
from animtool.core.record import dataclass
from animtool.maths import so3
from animtool.rig.placement import Placement


@dataclass(frozen=True, slots=True)
class Attribute:
    """A value that a thing has over time."""

    name: str  # as USD has it
    type_name: str  # likewise, such as ``float2``
    width: int = 1  # how many numbers it is; 0 where it is one of some choices
    # What it may be that is no number, and lasts until it is another.
    choices: tuple[object, ...] = ()
    length: bool = False  # whether its numbers are lengths, which are [m] then


@dataclass(frozen=True, slots=True)
class Reference:
    """What is to be seen of a thing."""

    file: str  # A USD file
    prim: str  # path of a prim in it; empty is its default prim
    meters_per_unit: float  # its length unit [m]


@dataclass(frozen=True, slots=True)
class PropRequest:
    """What is to be read of a file."""

    file: Path  # the USD file
    prim: str  # path of the prim
    # Where it is to be written: below the character, or from ``/`` on.
    path: str
    attributes: tuple[str, ...] = ()  # names of attributes beside those of a camera
    # File that shows it; the file itself with the prim, or another with its default
    # prim. None shows nothing.
    reference: Path | None = None


@dataclass(frozen=True, slots=True)
class Transforms:
    """Where a thing is at F times, in the world of the rig, and its values."""

    translations: FloatArray  # ``(F, 3)`` [m]
    rotations: FloatArray  # unit quaternions (x, y, z, w) ``(F, 4)``
    scales: FloatArray  # ``(F, 3)``
    # Column vectors, [m] ``(F, 4, 4)``, in place of the three where these do not come
    # to the same; None where they do.
    matrices: FloatArray | None = None
    # Of each attribute: numbers ``(F, width)``, or which of its choices ``(F,)``.
    values: tuple[npt.NDArray[Any], ...] = ()
    # Whether its file has no such time, and it is as at the nearest ``(F,)``; None
    # where it has them all.
    held: BoolArray | None = None

    def __len__(self) -> int:
        """Return the number of times."""
        return len(self.translations)

    def matrix(self) -> FloatArray:
        """Return the whole as matrices of column vectors, [m] ``(F, 4, 4)``.

        >>> still = np.zeros((1, 3)), np.array([[0, 0, 0, 1.0]]), np.ones((1, 3))
        >>> bool((Transforms(*still).matrix() == np.eye(4)).all())
        True
        """
        if self.matrices is not None:
            return self.matrices
        whole = np.tile(np.eye(4), (len(self), 1, 1))
        whole[:, :3, :3] = so3.to_matrix(self.rotations) * self.scales[:, None]
        whole[:, :3, 3] = self.translations
        return whole


# From times ``(F,)`` of the track's own, in any order.
Sampling: TypeAlias = Callable[[FloatArray], Transforms]


@dataclass(frozen=True, slots=True)
class Track:
    """A thing beside a rig: a function of a time of its own.

    A take says which of these times each of its frames shows, so that whatever cuts,
    resamples and retimes its frames does the same to the thing, without loss.
    """

    path: str  # where it is written: below the character, or from ``/`` on
    sample: Sampling  # gives it at times
    type_name: str = "Xform"  # of its prim; empty leaves it to the reference
    placed: bool = True  # whether it has a place in the world; else only attributes
    moves: bool = True  # whether anything of it changes over time
    attributes: tuple[Attribute, ...] = ()  # values that it has, in order
    reference: Reference | None = None  # what is to be seen; None is nothing
    # Whether it goes where the take is brought: it is of the stage of the take, or in
    # the space of the character.
    along: bool = False
    # Makes a fault of it, with the place where it is named.
    note: Callable[..., Fault] = Fault

    def at(self, times: FloatArray) -> Transforms:
        """Return the thing at times ``(F,)``, signs of rotations continuous."""
        transforms = self.sample(times)
        return replace(transforms, rotations=so3.align_signs(transforms.rotations))


def placed(transforms: Transforms, placement: Placement) -> Transforms:
    """Return transforms, brought to a placement of as many frames or of one."""
    if transforms.matrices is not None:
        whole = np.tile(np.eye(4), (len(placement.sizes), 1, 1))
        whole[:, :3, :3] = so3.to_matrix(placement.rotations)
        whole[:, :3, :3] *= placement.sizes[:, None, None]
        whole[:, :3, 3] = placement.translations
        return below_matrices(transforms, whole)
    points = placement.points(transforms.translations[:, None])[:, 0]
    rotations = placement.rotated(transforms.rotations[:, None])[:, 0]
    scales = transforms.scales
    if (placement.sizes != 1.0).any():
        scales = placement.sizes[:, None] * scales
    return replace(transforms, translations=points, rotations=rotations, scales=scales)


def below_matrices(transforms: Transforms, matrices: FloatArray) -> Transforms:
    """Return transforms after matrices of column vectors, [m] ``(F, 4, 4)`` or one."""
    return replace(transforms, matrices=matrices @ transforms.matrix())


def placed_track(track: Track, placement: Callable[[FloatArray], Placement]) -> Track:
    """Return a track that is brought somewhere, at times ``(F,)`` of its own."""
    if not track.placed:
        return track

    def sample(times: FloatArray) -> Transforms:
        return placed(track.sample(times), placement(times))

    return replace(track, sample=sample)


def turned_track(track: Track, turn: FloatArray) -> Track:
    """Return a track in a world that is turned ``(4,)``."""
    placement = Placement.from_rotation(turn)
    return placed_track(track, lambda _: placement)
