"""Tracks of props and cameras: transforms and attribute values over time."""

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
from animtool.rig.placement import Placement, placement_matrices


@dataclass(frozen=True, slots=True)
class Attribute:
    """An animated attribute of a prop."""

    name: str  # USD name
    type_name: str  # USD type, such as ``float2``
    width: int = 1  # number of components; 0 for a choice
    # Values of types that USD holds instead of interpolating.
    choices: tuple[object, ...] = ()
    is_length: bool = False  # whether its numbers are lengths [m]


@dataclass(frozen=True, slots=True)
class PropReference:
    """The USD asset that a prop shows."""

    file: str  # USD file
    prim: str  # path of a prim in it; empty is its default prim
    meters_per_unit: float  # length unit of the file [m]


@dataclass(frozen=True, slots=True)
class PropRequest:
    """A prop to read from a USD file."""

    file: Path  # the USD file
    prim: str  # path of the prim
    # Output path: below the character, or absolute from ``/``.
    path: str
    attributes: tuple[str, ...] = ()  # names of attributes besides a camera's
    # Asset to show: the file itself with the prim, or another with its default prim.
    # None shows nothing.
    reference: Path | None = None


@dataclass(frozen=True, slots=True)
class Transforms:
    """Transforms of a prop at F times in the world of the rig, and its attributes."""

    translations: FloatArray  # ``(F, 3)`` [m]
    rotations: FloatArray  # unit quaternions (x, y, z, w) ``(F, 4)``
    scales: FloatArray  # ``(F, 3)``
    # Matrices of column vectors [m] ``(F, 4, 4)``, if the three do not represent the
    # transform, as with shear; None otherwise.
    matrices: FloatArray | None = None
    # Values of each attribute ``(F, width)``, or indices of its choices ``(F,)``.
    values: tuple[npt.NDArray[Any], ...] = ()
    # Mask of times outside the file's range, whose values are held ``(F,)``; None if
    # there are none.
    is_clamped: BoolArray | None = None

    def __len__(self) -> int:
        """Return the number of times."""
        return len(self.translations)

    def matrix(self) -> FloatArray:
        """Return the transforms as matrices of column vectors [m] ``(F, 4, 4)``.

        >>> still = np.zeros((1, 3)), np.array([[0, 0, 0, 1.0]]), np.ones((1, 3))
        >>> bool((Transforms(*still).matrix() == np.eye(4)).all())
        True
        """
        if self.matrices is not None:
            return self.matrices
        matrices = np.tile(np.eye(4), (len(self), 1, 1))
        matrices[:, :3, :3] = so3.to_matrix(self.rotations) * self.scales[:, None]
        matrices[:, :3, 3] = self.translations
        return matrices


# Samples a track at its local times ``(F,)``, in any order.
Sampling: TypeAlias = Callable[[FloatArray], Transforms]


@dataclass(frozen=True, slots=True)
class Track:
    """A prop or camera: a function of its local time.

    A take stores the local time of each of its frames, so that passes that cut,
    resample or retime frames apply to the prop too, without loss.
    """

    path: str  # output path: below the character, or absolute from ``/``
    sample: Sampling  # samples the track at local times
    type_name: str = "Xform"  # type of the prim; empty uses the reference's type
    has_transform: bool = True  # whether it has a transform; else only attributes
    is_animated: bool = True  # whether the track changes over time
    attributes: tuple[Attribute, ...] = ()  # in order
    reference: PropReference | None = None  # asset to show; None shows nothing
    # Whether it follows the placement of the take: it belongs to the take's stage, or
    # is in the space of the character.
    follows_placement: bool = False
    # Creates a fault at the location where the track is named.
    note: Callable[..., Fault] = Fault

    def at(self, times: FloatArray) -> Transforms:
        """Return the transforms at times ``(F,)``, with continuous rotation signs."""
        transforms = self.sample(times)
        return replace(transforms, rotations=so3.align_signs(transforms.rotations))


def apply_placement(transforms: Transforms, placement: Placement) -> Transforms:
    """Apply a placement with one frame, or one per time, to transforms."""
    if transforms.matrices is not None:
        return transform_by_matrices(transforms, placement_matrices(placement))
    points = placement.transform_points(transforms.translations[:, None])[:, 0]
    rotations = placement.transform_rotations(transforms.rotations[:, None])[:, 0]
    scales = transforms.scales
    if (placement.sizes != 1.0).any():
        scales = placement.sizes[:, None] * scales
    return replace(transforms, translations=points, rotations=rotations, scales=scales)


def transform_by_matrices(transforms: Transforms, matrices: FloatArray) -> Transforms:
    """Return transforms multiplied from the left by matrices [m] ``(F, 4, 4)``."""
    return replace(transforms, matrices=matrices @ transforms.matrix())


def apply_animated_placement(
    track: Track, placement: Callable[[FloatArray], Placement]
) -> Track:
    """Return a track moved to a placement that depends on its local times ``(F,)``."""
    if not track.has_transform:
        return track

    def sample(times: FloatArray) -> Transforms:
        """Return the placed transforms at times."""
        return apply_placement(track.sample(times), placement(times))

    return replace(track, sample=sample)


def rotate_track(track: Track, rotation: FloatArray) -> Track:
    """Return a track rotated by a quaternion ``(4,)``."""
    placement = Placement.from_rotation(rotation)
    return apply_animated_placement(track, lambda _: placement)
