"""Blend shapes of the left eye: lids that turn about the eyeball, and skin below."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from head_mesh import CANTHUS, lid_elevation
from head_sculptor import Sculptor
from head_surface import EYE
from solids import Array

LIDS_MEET = 0.72  # of the way from the corners' line to the lower lid
BLINK_STEPS = (1 / 3, 2 / 3)


def bow(share: Array) -> Array:
    """Return 1 in the middle of a lid and 0 at its corners."""
    return np.asarray(np.maximum(1 - share * share, 0) ** 0.7)


def closing(upper: bool, amount: float) -> Callable[[Array], Array]:
    """Return the angle of a lid that goes a part of its way to where the lids meet."""

    def angle(share: Array) -> Array:
        low = np.broadcast_to(False, share.shape)
        line = CANTHUS * share
        meet = line + LIDS_MEET * (lid_elevation(share, low) - line)
        return amount * (
            meet - lid_elevation(share, np.broadcast_to(upper, share.shape))
        )

    return angle


def lifting(degrees: float) -> Callable[[Array], Array]:
    """Return the angle of a lid that goes up by so much in its middle."""
    return lambda share: np.radians(degrees) * bow(share)


def blink(s: Sculptor, amount: float) -> Array:
    """Return lids so far closed on the left."""
    return s.lids(closing(True, amount), closing(False, amount))


def eye_shapes(s: Sculptor) -> tuple[dict[str, Array], dict[str, Array]]:
    """Return shapes of the left eye, and the share of their lids' motion in each."""
    lids = {
        "eyeLookDown": s.lids(closing(True, 0.42), lifting(-4.0)),
        "eyeLookUp": s.lids(lifting(6.5), lifting(2.0)),
        "eyeSquint": s.lids(lifting(-4.5), lifting(8.0)),
        "eyeWide": s.lids(lifting(9.0), lifting(-3.5)),
        "cheekSquint": s.lids(lifting(0.0), lifting(4.5)),
    }
    made = {"eyeBlink": blink(s, 1.0), **lids}
    near = s.lid_weights()[2]
    for name, sign in (("eyeLookIn", -1.0), ("eyeLookOut", 1.0)):
        off = s.points - EYE
        turn = (
            np.radians(2.5)
            * sign
            * near
            * np.cos(np.arctan2(off[:, 1], off[:, 2])) ** 2
        )
        c, n = np.cos(turn) - 1, np.sin(turn)
        made[name] = np.column_stack(
            [
                c * off[:, 0] + n * off[:, 2],
                np.zeros(len(off)),
                c * off[:, 2] - n * off[:, 0],
            ]
        )
    made["eyeSquint"] = made["eyeSquint"] + s.slid(
        s.pull((0.034, 0.192, 0.08), (0.026, 0.014, 0.03), (0, 0.0022, 0.0006))
    )
    made["cheekSquint"] = (
        made["cheekSquint"]
        + s.slid(
            s.pull((0.038, 0.184, 0.072), (0.03, 0.018, 0.03), (0.0005, 0.0048, 0.001))
        )
        + s.pull((0.040, 0.186, 0.075), (0.024, 0.014, 0.03), (0.001, 0.001, 0.0026))
    )
    return made, lids
