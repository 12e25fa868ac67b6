"""Feet of takes for tests of retargeting."""

from __future__ import annotations

from typing import Any

import numpy as np

from animtool.maths import so3
from animtool.retarget.feet import Foot, FootContacts


def foot(frames: int, stands: FootContacts | None = None, **keys: Any) -> Foot:
    """Return a foot without a toe, 0.9 m below its hip, that stands all the time."""
    all_of_it = np.ones(frames, np.bool_)
    given: dict[str, Any] = {
        "contacts": stands or FootContacts(all_of_it, all_of_it, 0.08),
        "hip": np.zeros((frames, 3)),
        "ankle": np.tile([0.1, -0.9, 0.0], (frames, 1)),
        "toe": None,
        "rotation": np.tile(so3.IDENTITY, (frames, 1)),
        "flat_rotation": so3.IDENTITY,
        "height": 0.08,
        "leg_length": 0.9,
        "min_reach": 0.1,
        "height_change": np.zeros(frames),
        "straightness": np.ones(frames),
    }
    return Foot(**{**given, **keys})
