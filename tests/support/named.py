"""How right the names are that the points of a cloud were given."""

from __future__ import annotations

from typing import Any

import numpy as np

from animtool.motion.markers import Markers


def scores_of(named: Markers, cloud: Markers, perm: Any) -> tuple[float, float]:
    """Return precision and recall of names.

    perm: The true marker of each point of the cloud ``(F, P)``; -1 for none.
    """
    own = np.full((len(cloud), len(named.names) + 1, 3), np.nan)
    frame, slot = np.nonzero(perm >= 0)
    own[frame, perm[frame, slot]] = cloud.positions[frame, slot]
    own = own[:, :-1]
    right = (named.visible & (named.positions == own).all(axis=-1)).sum()
    there = np.isfinite(own[..., 0]).sum()
    return float(right / max(1, named.visible.sum())), float(right / there)
