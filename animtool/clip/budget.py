"""How much error each local channel may have, for the world to keep its tolerance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from animtool._types import ArrayLike, FloatArray, IntArray
from animtool.clip.reduction import ChannelKind
from animtool.clip.tracks import Track
from animtool.maths.fit import FittedKeys, evaluate_keys, fit_keys


@dataclass(slots=True)
class Budget:
    """A track, the tolerance that it has for now, and the keys that this gives.

    Attributes:
        track: Samples of one channel.
        tolerance: For the Euclidean error, in the unit of the samples.
        share: Of the tolerance that each frame has ``(F,)`` [1].
        keys: Fitted to the samples.
        errors: Of these keys at every frame ``(F,)``, in the unit of the samples.
        values: Of these keys at every frame ``(F, D)``.
    """

    track: Track
    tolerance: float
    share: FloatArray
    keys: FittedKeys
    errors: FloatArray
    values: FloatArray

    @staticmethod
    def of(track: Track, tolerance: float) -> Budget:
        """Return a track with its first keys."""
        frames = len(track.samples)
        keys = fit_keys(track.samples, tolerance)
        blank = np.zeros(frames)
        made = Budget(track, tolerance, np.ones(frames), keys, blank, track.samples)
        made.settle()
        return made

    def scale(self, factor: float) -> None:
        """Fit again with a tolerance so many times as large."""
        self.tolerance *= factor
        self.share = np.ones(len(self.share))
        self.fit()

    def tighten(self, frames: ArrayLike, wanted: ArrayLike, *, spread: bool) -> None:
        """Fit the segments around some frames again, the others stay.

        Args:
            frames: Where the error is too large, ascending ``(N,)`` [frame].
            wanted: What it should be there ``(N,)``, in the unit of the samples.
            spread: Whether a key behind such a segment may move.
        """
        at, limits = np.asarray(frames), np.asarray(wanted) / self.tolerance
        starts = self.keys.frames
        segment = np.searchsorted(starts, at, side="right") - 1
        segment = segment.clip(0, max(0, len(starts) - 2))
        lengths = np.diff(starts) if len(starts) > 1 else np.array([len(self.share)])
        around = np.maximum(1, lengths[segment] // 4)
        for frame, limit, width in zip(at, limits, around, strict=True):
            near = slice(max(0, int(frame - width)), int(frame + width + 1))
            self.share[near] = np.minimum(self.share[near], limit)
        held = np.ones(len(starts), np.bool_)
        marked = np.unique(segment)
        if spread:
            held[(marked + 1).clip(max=len(starts) - 1)] = False
        else:
            both = marked[np.isin(marked + 1, marked)]
            held[(both + 1).clip(max=len(starts) - 1)] = False
        self.fit(starts[1:-1][held[1:-1]])

    def fit(self, anchors: ArrayLike = ()) -> None:
        """Fit keys with the tolerance and shares as they are."""
        self.keys = fit_keys(
            self.track.samples, self.tolerance, share=self.share, anchors=anchors
        )
        self.settle()

    def settle(self) -> None:
        """Evaluate the keys at every frame."""
        samples = self.track.samples
        self.values = evaluate_keys(self.keys, np.arange(len(samples)))
        self.errors = np.linalg.norm(self.values - samples, axis=1)

    def unit_motion(self, arm: FloatArray | float) -> FloatArray:
        """Return how far one unit of error moves what is so far off the joint."""
        lever = np.asarray(arm, np.float64)
        if self.track.kind is ChannelKind.TRANSLATION:
            return np.ones_like(lever)
        return np.radians(lever) if self.track.kind is ChannelKind.ROTATION else lever


def subtree_largest(parents: IntArray, values: FloatArray) -> FloatArray:
    """Return the largest of each joint's values ``(F, J)`` and its descendants'."""
    found = np.ascontiguousarray(values.T)
    for joint in range(len(found) - 1, -1, -1):
        if parents[joint] >= 0:
            above = found[parents[joint]]
            np.maximum(above, found[joint], out=above)
    return found.T
