"""The blend shapes of the head: the 52 names of ARKit and correctives of pairs.

Shapes of one side are made for the left and mirrored. Lids turn about the eyeball, the
jaw about its hinge; all else are pulls that fade with distance, the skin kept on the
skull beneath it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from head_mesh import (
    CANTHUS,
    LID_HALF_WIDTH,
    MOUTH_HALF_WIDTH,
    lid_elevation,
    lip_line,
)
from head_surface import EYE, LID_RADIUS, head_field
from numpy.typing import NDArray
from solids import Array, Ints, curve, falloff, gradient, length, smoothstep

Shapes = dict[str, Array]

HINGE = np.array([0.0, 0.172, 0.008])  # of the jaw
JAW_OPEN = np.radians(21)
CORNER = (0.0245, 0.1426, 0.083)  # of the mouth
LIDS_MEET = 0.72  # of the way from the corners' line to the lower lid
BLINK_STEPS = (1 / 3, 2 / 3)
LID_SPREAD = 8  # steps of smoothing
LEAST_ANGLE = 2e-4
BROW_HOLDERS = 6  # points of the skin that hold one of a brow
# Correctives: name, drivers.
COMBINED = {
    f"{first}_{second}{side}": (
        first if first == "jawOpen" else first + side,
        second + side,
    )
    for side in ("Left", "Right")
    for first, second in (
        ("jawOpen", "mouthSmile"),
        ("eyeBlink", "eyeLookDown"),
        ("eyeBlink", "eyeLookUp"),
        ("eyeBlink", "eyeSquint"),
        ("eyeBlink", "eyeWide"),
        ("eyeBlink", "cheekSquint"),
    )
}


@dataclass(frozen=True, slots=True)
class Sculptor:
    """The neutral face and what shapes ask about it.

    Attributes:
        points: ``(V, 3)``.
        part: Name of the part of each point.
        side: 1 on an upper lid or lip, -1 on a lower one.
        share: Way from the middle of the mouth to the corner, or along an eye.
        mirror: Index of each point's mirror image.
        pairs: Neighbours ``(E, 2)``.
    """

    points: Array
    part: NDArray[np.str_]
    side: Array
    share: Array
    mirror: Ints
    pairs: Ints

    def pull(
        self, centre: Sequence[float], radii: Sequence[float], move: Sequence[float]
    ) -> Array:
        """Return a pull that fades out at the radii ``(V, 3)``."""
        return falloff(self.points, centre, radii)[:, None] * np.array(move)

    def slid(self, move: Array) -> Array:
        """Return a move with the skin kept as far from the skull as they were."""
        loose = (self.part == "skin") & (move != 0).any(1)
        there = self.points[loose] + move[loose]
        off = head_field(self.points[loose]) - head_field(there)
        share = 0.85 * smoothstep(0.004, 0.014, np.abs(self.lip_distance()[loose]))
        away = gradient(head_field, there)
        made = move.copy()
        made[loose] += np.clip(off * share, -0.006, 0.006)[:, None] * away
        return made

    def lip_distance(self) -> Array:
        """Return how far a point is above the line of the lips, large off the mouth."""
        x, y, z = self.points.T
        off = np.maximum(np.abs(x) - MOUTH_HALF_WIDTH, 0.0)
        above = y - lip_line(np.minimum(np.abs(x), MOUTH_HALF_WIDTH))
        sign = np.where(above < 0, -1.0, 1.0)
        far = np.sqrt(above**2 + off**2 + np.maximum(0.07 - z, 0) ** 2)
        mouth = np.isin(self.part, ["lip", "pocket"])
        return np.where(mouth, above, sign * far)

    def jaw(self) -> Array:
        """Return how far a point follows the jaw, from 0 to 1."""
        x, y, z = self.points.T
        x = np.abs(x)
        across = x / MOUTH_HALF_WIDTH
        back = (z - HINGE[2]) / (CORNER[2] - HINGE[2])
        seam = HINGE[1] + (CORNER[1] - HINGE[1]) * np.clip(back, 0, 1.2)
        lips = lip_line(np.minimum(x, MOUTH_HALF_WIDTH))
        line = lips + (seam - lips) * smoothstep(0.6, 1.3, across)
        band = 0.0012 + 0.0068 * np.clip(across, 0, 1) ** 2.2
        band = band + 0.024 * smoothstep(0.9, 2.3, across)
        low = smoothstep(-band, band, line - y)
        throat = smoothstep(0.062, 0.112, y + 0.45 * (z - 0.03))
        made = low * throat * smoothstep(-0.035, 0.012, z)
        corner = 0.5 * np.abs(self.share) ** 2.2
        lip = np.where(self.side > 0, corner, 1 - corner)
        lip = np.where(self.side == 0, 0.5, lip)
        made = np.where(np.isin(self.part, ["lip", "pocket"]), lip, made)
        for part, follows in (("lower_teeth", 1.0), ("tongue", 0.92)):
            made = np.where(self.part == part, follows, made)
        return np.where(
            np.isin(self.part, ["upper_teeth", "ear", "brow", "rim", "lining"]),
            0.0,
            made,
        )

    def jaw_turn(self, angle: float) -> Array:
        """Return the way of the jaw as it opens by an angle ``(V, 3)``."""
        turn = angle * self.jaw()
        return turned(self.points, HINGE, turn)

    def lids(
        self, upper: Callable[[Array], Array], lower: Callable[[Array], Array]
    ) -> Array:
        """Return lids turned about the left eyeball ``(V, 3)``.

        Args:
            upper: Angle up of the upper lid's rim, from the share of the way along it.
            lower: That of the lower lid.
        """
        share, up, weight = self.lid_weights()
        angle = self.spread(np.where(up, upper(share), lower(share)) * weight)
        return turned(self.points, EYE, -angle)

    def spread(self, angle: Array) -> Array:
        """Return a lid's angle smoothed over the skin, the rims kept."""
        skin = self.part == "skin"
        count = np.bincount(self.pairs.ravel(), minlength=len(angle))
        first, second = self.pairs.T
        for _ in range(LID_SPREAD):
            total = np.bincount(first, angle[second], len(angle))
            total += np.bincount(second, angle[first], len(angle))
            mean = total / np.maximum(count, 1)
            angle = np.where(skin, 0.5 * (angle + mean), angle)
        return np.where(np.abs(angle) < LEAST_ANGLE, 0.0, angle)

    def lid_weights(self) -> tuple[Array, NDArray[np.bool_], Array]:
        """Return share of the way along the left eye, whether upper lid, and weight."""
        off = self.points - EYE
        far = length(off)
        side = np.arcsin(np.clip(off[:, 0] / far, -1, 1))
        lift = np.arctan2(off[:, 1], off[:, 2])
        share = np.clip(side / LID_HALF_WIDTH, -1, 1)
        inner = np.isin(self.part, ["rim", "lining"])
        share = np.where(inner, self.share, share)
        up = np.where(inner, self.side > 0, lift > CANTHUS * share)
        rim = lid_elevation(share, up)
        beyond = np.where(up, lift - rim, rim - lift)
        weight = smoothstep(np.radians(58), np.radians(4), beyond)
        weight = weight * smoothstep(LID_RADIUS + 0.013, LID_RADIUS + 0.001, far)
        weight = weight * (off[:, 2] > 0) * (self.part == "skin")
        weight = np.where(
            inner & (off[:, 0] * EYE[0] > -1) & (self.points[:, 0] > 0),
            np.abs(self.side),
            weight,
        )
        return share, np.asarray(up), weight

    def with_brows(self, move: Array) -> Array:
        """Return a move in which the brows go with the skin beneath them."""
        skin = np.flatnonzero(self.part == "skin")
        left = np.flatnonzero((self.part == "brow") & (self.points[:, 0] > 0))
        away = length(self.points[left][:, None] - self.points[skin][None])
        near = np.argsort(away, axis=1, kind="stable")[:, :BROW_HOLDERS]
        share = 1 / (np.take_along_axis(away, near, axis=1) + 1e-4) ** 2
        share /= share.sum(1, keepdims=True)
        made = move.copy()
        for brow, held in (
            (left, skin[near]),
            (self.mirror[left], self.mirror[skin[near]]),
        ):
            made[brow] = np.einsum("bk,bkc->bc", share, move[held])
        return made

    def mirrored(self, move: Array) -> Array:
        """Return the mirror image of a move."""
        return np.asarray(move[self.mirror] * [-1.0, 1.0, 1.0])


def turned(points: Array, centre: Array, angle: Array) -> Array:
    """Return the way of points turned about the X axis through a centre ``(V, 3)``."""
    _, y, z = (points - centre).T
    c, s = np.cos(angle) - 1, np.sin(angle)
    return np.column_stack([np.zeros(len(points)), c * y - s * z, s * y + c * z])


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


def eye_shapes(s: Sculptor) -> tuple[Shapes, Shapes]:
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


def mouth_shapes(s: Sculptor) -> Shapes:
    """Return shapes of the left half of the mouth."""
    low = s.jaw()[:, None]
    wide = (0.037, 0.032, 0.050)
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
    front = falloff(s.points, (0, 0.1432, 0.09), (0.042, 0.03, 0.045))
    thin = np.clip(off, -0.009, 0.009) * near * smoothstep(0.0, 0.35, front)
    zero = np.zeros(len(off))
    return np.column_stack([zero, -amount * thin, -0.25 * np.abs(thin)])


def middle_shapes(s: Sculptor) -> Shapes:
    """Return shapes that are their own mirror image, or whose pair is no mirror one."""
    x = s.points[:, 0]
    low = s.jaw()[:, None]
    lip = np.isin(s.part, ["lip", "pocket"])
    round_ = falloff(s.points, (0, 0.1432, 0.098), (0.052, 0.040, 0.062))
    zero = np.zeros(len(x))
    off = s.lip_distance()
    lips = smoothstep(0.018, 0.005, np.abs(off)) * round_
    thick = np.clip(off, -0.009, 0.009)
    pucker = np.column_stack(
        [
            -0.46 * x * round_,
            0.22 * thick * lips,
            0.0090 * round_ * (1 - 0.3 * (x / 0.03) ** 2),
        ]
    )
    funnel = np.column_stack([-0.30 * x * round_, zero, 0.0085 * round_])
    part_lips = s.pull((0, 0.1432, 0.096), (0.022, 0.022, 0.04), (0, 1, 0))
    funnel = funnel + part_lips * np.where(low > 0.5, -0.0052, 0.0042) * np.abs(
        2 * low - 1
    )
    aside = s.pull((0, 0.1432, 0.09), (0.052, 0.036, 0.06), (0.0085, 0, 0))
    both = s.pull((0, 0.140, 0.094), (0.034, 0.026, 0.05), (0, 1, 0))
    shove = s.pull((0, 0.138, 0.096), (0.032, 0.020, 0.04), (0, 0, 1))
    chin = s.pull((0, 0.116, 0.092), (0.026, 0.018, 0.03), (0, 0.0042, 0.0014))
    roll = smoothstep(0.014, 0.003, np.abs(off)) * round_
    rolled = np.column_stack([zero, -0.55 * thick * roll, -0.0042 * roll])
    cheeks = sum(
        (
            s.pull(
                (sign * 0.044, 0.150, 0.062),
                (0.032, 0.032, 0.05),
                (sign * 0.0085, 0, 0.0055),
            )
            for sign in (1, -1)
        ),
        np.zeros_like(s.points),
    )
    jaw = s.jaw_turn(JAW_OPEN)
    inwards = sum(
        (
            s.pull(
                (sign * CORNER[0], *CORNER[1:]),
                (0.022, 0.024, 0.04),
                (-sign * 0.0022, 0, 0),
            )
            for sign in (1, -1)
        ),
        np.zeros_like(s.points),
    )
    inner = sum(
        (
            s.pull((sign * 0.011, 0.243, 0.09), (0.026, 0.030, 0.035), (0, 0.0085, 0))
            for sign in (1, -1)
        ),
        np.zeros_like(s.points),
    )
    inner /= np.maximum(1.0, inner[:, 1:2] / 0.0085)
    return {
        "jawOpen": jaw + inwards,
        "jawForward": low * [0, 0, 0.0065],
        "jawLeft": low * [0.0085, 0, 0],
        "jawRight": low * [-0.0085, 0, 0],
        "mouthClose": closed(s, jaw + inwards),
        "mouthFunnel": funnel,
        "mouthPucker": pucker,
        "mouthLeft": s.slid(aside),
        "mouthRight": s.slid(s.mirrored(aside)),
        "mouthRollLower": rolled * low * (lip | (off < 0))[:, None],
        "mouthRollUpper": rolled * (1 - low) * (lip | (off > 0))[:, None],
        "mouthShrugLower": both * 0.0028 + shove * low * 0.0042 + chin,
        "mouthShrugUpper": both * 0.0034 + shove * (1 - low) * 0.0024,
        "cheekPuff": cheeks + pressed(s, 0.12),
        "browInnerUp": s.slid(inner),
        "tongueOut": tongue(s),
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


def all_shapes(s: Sculptor) -> Shapes:
    """Return every array of deltas by name, ``NAME_at_33`` those on a shape's way."""
    eyes, lids = eye_shapes(s)
    left = {**eyes, **brow_shapes(s), **mouth_shapes(s)}
    middle = middle_shapes(s)
    made = {**middle, "mouthRight": s.mirrored(middle["mouthLeft"])}
    for step in BLINK_STEPS:
        left[f"eyeBlink{{}}_at_{round(100 * step)}"] = blink(s, step)
    for name, move in left.items():
        pattern = name if "{}" in name else name + "{}"
        made[pattern.format("Left")] = move
        made[pattern.format("Right")] = s.mirrored(move)
    made["jawOpen_mouthSmileLeft"] = corrective_smile(s)
    for name, (_, second) in COMBINED.items():
        if name.endswith("Left") and name.startswith("eyeBlink"):
            made[name] = -lids[second.removesuffix("Left")]
        if name.endswith("Right"):
            made[name] = s.mirrored(made[name.removesuffix("Right") + "Left"])
    return {name: s.with_brows(move) for name, move in made.items()}
