"""The blend shapes of the head: the 52 names of ARKit and correctives of pairs.

Shapes of one side are made for the left and mirrored. Lids turn about the eyeball, the
jaw about its hinge; all else are pulls that fade with distance, the skin kept on the
skull beneath it.
"""

from __future__ import annotations

import numpy as np
from head_lids import BLINK_STEPS, blink, eye_shapes
from head_mouth import corrective_smile, middle_shapes, mouth_shapes
from head_sculptor import Sculptor
from solids import Array

Shapes = dict[str, Array]


def brow_shapes(s: Sculptor) -> Shapes:
    """Return shapes of the left brow, cheek and nose."""
    down = s.pull(
        (0.017, 0.242, 0.088), (0.026, 0.020, 0.03), (-0.0035, -0.0062, 0.0005)
    )
    down = down + s.pull(
        (0.040, 0.242, 0.075), (0.028, 0.018, 0.03), (-0.001, -0.0040, 0)
    )
    frown = s.pull((0.008, 0.240, 0.092), (0.009, 0.016, 0.03), (0, 0, 0.0016))
    up = s.pull((0.042, 0.243, 0.073), (0.030, 0.030, 0.035), (0.0006, 0.0092, -0.001))
    up = up + s.pull((0.036, 0.228, 0.085), (0.024, 0.014, 0.03), (0, 0.0022, 0))
    sneer = s.pull(
        (0.013, 0.174, 0.10), (0.015, 0.022, 0.026), (0.0012, 0.0050, -0.0012)
    )
    sneer = (
        sneer
        + s.pull((0.016, 0.158, 0.095), (0.018, 0.012, 0.03), (0, 0.0028, 0.0004))
        * (1 - s.jaw())[:, None]
    )
    fold = s.pull((0.008, 0.200, 0.09), (0.010, 0.018, 0.03), (0, 0.0020, 0.0014))
    return {
        "browDown": s.slid(down) + frown,
        "browOuterUp": s.slid(up),
        "noseSneer": sneer + fold,
    }


def inner_brows(s: Sculptor) -> Array:
    """Return the inner ends of both brows raised."""
    made = s.pulls((0.011, 0.243, 0.09), (0.026, 0.030, 0.035), (0, 0.0085, 0))
    return s.slid(made / np.maximum(1.0, made[:, 1:2] / 0.0085))


def all_shapes(s: Sculptor) -> Shapes:
    """Return every array of deltas by name, ``NAME_at_33`` those on a shape's way."""
    eyes, lids = eye_shapes(s)
    one_side = {**eyes, **brow_shapes(s), **mouth_shapes(s)}
    middle = {"browInnerUp": inner_brows(s), **middle_shapes(s)}
    left = {f"{name}Left": move for name, move in one_side.items()}
    left |= {
        f"eyeBlinkLeft_at_{round(100 * step)}": blink(s, step) for step in BLINK_STEPS
    }
    left |= {f"eyeBlink_{name}Left": -move for name, move in lids.items()}
    left["jawOpen_mouthSmileLeft"] = corrective_smile(s)
    right = {
        name.replace("Left", "Right"): s.mirrored(move) for name, move in left.items()
    }
    made = {**middle, **left, **right, "mouthRight": s.mirrored(middle["mouthLeft"])}
    return {name: s.with_brows(move) for name, move in made.items()}
