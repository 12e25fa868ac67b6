"""Colours of the head's points, from 0 to 1, for pictures."""

from __future__ import annotations

import numpy as np
from head_parts import GUM, IRIS, LOWER_TEETH, PUPIL, UPPER_TEETH
from head_surface import EYE, EYE_RADIUS
from numpy.typing import NDArray
from solids import Array, curve, falloff

PARTS = {
    "skin": (0.86, 0.67, 0.57),
    "lip": (0.74, 0.41, 0.39),
    "rim": (0.80, 0.52, 0.47),
    "lining": (0.70, 0.36, 0.34),
    "pocket": (0.40, 0.13, 0.13),
    "ear": (0.86, 0.64, 0.54),
    "upper_teeth": (0.95, 0.93, 0.88),
    "lower_teeth": (0.93, 0.91, 0.86),
    "hair": (0.26, 0.18, 0.14),
    "brow": (0.36, 0.25, 0.19),
    "tongue": (0.78, 0.40, 0.40),
}
BLUSH = np.array([0.85, 0.52, 0.46])


def mixed(colours: Array, other: Array, share: Array) -> Array:
    """Return colours with a share of another."""
    return np.asarray(colours + share[:, None] * (other - colours))


def face_colours(points: Array, part: NDArray[np.str_]) -> Array:
    """Return colours of the face ``(V, 3)``."""
    made = np.array([PARTS[name] for name in part])
    y = points[:, 1]
    gum = (part == "upper_teeth") & (y > UPPER_TEETH[0] - GUM - 1e-4)
    gum |= (part == "lower_teeth") & (y < LOWER_TEETH[1] + GUM + 1e-4)
    made[gum] = PARTS["tongue"]
    skin = np.isin(part, ["skin", "ear"])
    left = np.abs(points) * [1, 0, 0] + points * [0, 1, 1]
    red = 0.45 * falloff(left, (0.042, 0.178, 0.065), (0.026, 0.02, 0.05))
    red = red + 0.45 * falloff(left, (0, 0.172, 0.115), (0.02, 0.02, 0.03))
    return mixed(made, BLUSH, red * skin)


def eye_colours(points: Array) -> Array:
    """Return colours of the left eyeball ``(V, 3)``."""
    away = np.arccos(np.clip((points - EYE)[:, 2] / EYE_RADIUS, -1, 1))
    table = [(0.03, 0.03, 0.03)] * 2 + [
        (0.22, 0.38, 0.42),
        (0.38, 0.55, 0.58),
        (0.12, 0.18, 0.22),
        (1.0, 0.99, 0.97),
        (1.0, 0.98, 0.96),
        (0.85, 0.6, 0.55),
    ]
    knots = (
        0,
        PUPIL - 0.002,
        PUPIL + 0.01,
        IRIS - 0.05,
        IRIS - 0.005,
        IRIS + 0.02,
        1.0,
        1.6,
    )
    return curve(knots, table, away)
