"""Blend shapes of mouth and jaw: those of the left half, and those of the whole."""

from __future__ import annotations

import numpy as np
from head_mesh import MOUTH_HALF_WIDTH
from head_sculptor import CORNER, Sculptor
from numpy.typing import NDArray
from solids import Array, curve, smoothstep

JAW_OPEN = np.radians(21)


def mouth_shapes(s: Sculptor) -> dict[str, Array]:
    """Return shapes of the left half of the mouth."""
    low = s.jaw()[:, None]
    wide = (0.033, 0.031, 0.050)
    smile = s.pull(CORNER, wide, (0.0098, 0.0095, -0.0062))
    smile = smile + s.pull(
        (0.042, 0.174, 0.068), (0.030, 0.022, 0.035), (0.001, 0.0042, 0.001)
    )
    cheek = s.pull(
        (0.038, 0.166, 0.074), (0.022, 0.018, 0.03), (0.0022, 0.0006, 0.0030)
    )
    frown = s.pull(CORNER, (0.034, 0.028, 0.050), (0.0016, -0.0082, -0.0010))
    frown = frown + s.pull(
        (0.014, 0.122, 0.09), (0.02, 0.014, 0.04), (0, 0.0015, 0.0008)
    )
    dimple = s.pull(CORNER, (0.022, 0.018, 0.04), (0.0050, 0.0012, -0.0062))
    stretch = s.pull(CORNER, (0.032, 0.028, 0.045), (0.0092, -0.0038, -0.0050))
    stretch = stretch + s.pull(
        (0.035, 0.09, 0.05), (0.03, 0.03, 0.05), (0.002, -0.003, 0)
    )
    raised = s.pull(
        (0.011, 0.149, 0.096), (0.019, 0.022, 0.04), (0.0006, 0.0062, 0.0012)
    )
    lowered = s.pull(
        (0.011, 0.136, 0.096), (0.019, 0.024, 0.04), (0.0006, -0.0068, 0.0012)
    )
    return {
        "mouthSmile": s.slid(smile) + cheek,
        "mouthFrown": s.slid(frown),
        "mouthDimple": dimple,
        "mouthStretch": s.slid(stretch),
        "mouthUpperUp": raised * (1 - low),
        "mouthLowerDown": lowered * low,
        "mouthPress": pressed(s, 0.34) * left_half(s),
    }


def left_half(s: Sculptor) -> Array:
    """Return 1 on the left, 0 on the right, smooth across the middle ``(V, 1)``."""
    return smoothstep(-0.006, 0.006, s.points[:, :1])


def pressed(s: Sculptor, amount: float) -> Array:
    """Return lips that thin towards their line."""
    off = s.lip_distance()
    near = smoothstep(0.020, 0.006, np.abs(off)) * np.isin(s.part, ["skin", "lip"])
    front = s.near((0, 0.1432, 0.09), (0.042, 0.03, 0.045))
    thin = np.clip(off, -0.009, 0.009) * near * smoothstep(0.0, 0.35, front)
    zero = np.zeros(len(off))
    return np.column_stack([zero, -amount * thin, -0.25 * np.abs(thin)])


def middle_shapes(s: Sculptor) -> dict[str, Array]:
    """Return shapes of the whole mouth and of the jaw."""
    return {**jaw_shapes(s), **round_shapes(s), **lip_shapes(s), "tongueOut": tongue(s)}


def jaw_shapes(s: Sculptor) -> dict[str, Array]:
    """Return shapes of the jaw, and the lips that close over it."""
    low = s.jaw()[:, None]
    inwards = s.pulls(CORNER, (0.022, 0.024, 0.04), (-0.0022, 0, 0))
    open_ = s.jaw_turn(JAW_OPEN) + inwards
    return {
        "jawOpen": open_,
        "jawForward": low * [0, 0, 0.0065],
        "jawLeft": low * [0.0085, 0, 0],
        "jawRight": low * [-0.0085, 0, 0],
        "mouthClose": closed(s, open_),
    }


def round_shapes(s: Sculptor) -> dict[str, Array]:
    """Return shapes that draw the mouth together or aside, or blow it up."""
    x, zero, low = s.points[:, 0], np.zeros(len(s.points)), s.jaw()
    near = s.near((0, 0.1432, 0.098), (0.052, 0.040, 0.062))
    off = s.lip_distance()
    thick = np.clip(off, -0.009, 0.009) * smoothstep(0.018, 0.005, np.abs(off)) * near
    forwards = 0.0090 * near * (1 - 0.3 * (x / 0.03) ** 2)
    funnel = np.column_stack([-0.30 * x * near, zero, 0.0085 * near])
    apart = np.where(low > 0.5, -0.0052, 0.0042) * np.abs(2 * low - 1)
    parted = s.pull((0, 0.1432, 0.096), (0.022, 0.022, 0.04), (0, 1, 0))
    passthrough = s.pull((0, 0.1432, 0.09), (0.052, 0.036, 0.06), (0.0085, 0, 0))
    cheeks = s.pulls((0.044, 0.150, 0.062), (0.032, 0.032, 0.05), (0.0085, 0, 0.0055))
    return {
        "mouthPucker": np.column_stack([-0.46 * x * near, 0.22 * thick, forwards]),
        "mouthFunnel": funnel + parted * apart[:, None],
        "mouthLeft": s.slid(passthrough),
        "cheekPuff": cheeks + pressed(s, 0.12),
    }


def lip_shapes(s: Sculptor) -> dict[str, Array]:
    """Return shapes that roll the lips in or push them up."""
    low, zero = s.jaw()[:, None], np.zeros(len(s.points))
    lip = np.isin(s.part, ["lip", "pocket"])
    off = s.lip_distance()
    near = s.near((0, 0.1432, 0.098), (0.052, 0.040, 0.062))
    roll = smoothstep(0.014, 0.003, np.abs(off)) * near
    thick = np.clip(off, -0.009, 0.009)
    rolled = np.column_stack([zero, -0.55 * thick * roll, -0.0042 * roll])
    both = s.pull((0, 0.140, 0.094), (0.034, 0.026, 0.05), (0, 1, 0))
    shove = s.pull((0, 0.138, 0.096), (0.032, 0.020, 0.04), (0, 0, 1))
    chin = s.pull((0, 0.116, 0.092), (0.026, 0.018, 0.03), (0, 0.0042, 0.0014))
    return {
        "mouthRollLower": rolled * low * (lip | (off < 0))[:, None],
        "mouthRollUpper": rolled * (1 - low) * (lip | (off > 0))[:, None],
        "mouthShrugLower": both * 0.0028 + shove * low * 0.0042 + chin,
        "mouthShrugUpper": both * 0.0034 + shove * (1 - low) * 0.0024,
    }


def closed(s: Sculptor, jaw: Array) -> Array:
    """Return lips that meet again over the open jaw."""
    contact = contact_ring(s)
    gap = {}
    for sign in (1, -1):
        ring = contact & (s.side == sign) & (s.points[:, 0] >= 0)
        order = np.argsort(s.share[ring])
        gap[sign] = s.share[ring][order], jaw[ring][order]
    corner = contact & (s.side == 0) & (s.points[:, 0] > 0)
    end = jaw[corner][0]
    x = np.clip(np.abs(s.points[:, 0]) / MOUTH_HALF_WIDTH, 0, 1)
    share = np.where(np.isin(s.part, ["lip", "pocket"]), s.share, x)
    found = [
        curve([*gap[sign][0], 1.0], np.vstack([gap[sign][1], end]), share)
        for sign in (1, -1)
    ]
    apart = (found[0] - found[1]) * [0, 1, 1]
    near = smoothstep(0.030, 0.004, np.abs(s.lip_distance())) * (s.points[:, 2] > 0.05)
    near = near * np.isin(s.part, ["skin", "lip", "pocket"])
    low = s.jaw()
    lower = np.where(s.part == "skin", smoothstep(0.2, 0.8, low), (s.side < 0) * 1.0)
    way = lower * 0.6 - (1 - lower) * 0.4
    return apart * (way * near)[:, None]


def contact_ring(s: Sculptor) -> NDArray[np.bool_]:
    """Return which points lie where the lips touch."""
    lip = s.part == "lip"
    return np.asarray(lip & (np.abs(s.lip_distance()) < 0.0002))


def tongue(s: Sculptor) -> Array:
    """Return the tongue put out."""
    z = s.points[:, 2]
    along = smoothstep(0.035, 0.078, z) * (s.part == "tongue")
    out = along * 0.034
    return np.column_stack(
        [-0.12 * s.points[:, 0] * along, 0.0025 * along - 0.007 * along**3, out]
    )


def corrective_smile(s: Sculptor) -> Array:
    """Return what the left corner lacks in an open smile."""
    made = s.pull(CORNER, (0.022, 0.022, 0.04), (0.0040, 0.0030, -0.0022))
    made = made + s.pull(
        (0.040, 0.160, 0.07), (0.022, 0.02, 0.03), (0.0022, 0.0012, 0.0022)
    )
    lower = s.pull(
        (0.013, 0.134, 0.095), (0.020, 0.016, 0.04), (0.0008, 0.0028, -0.0006)
    )
    return made + lower * s.jaw()[:, None]
