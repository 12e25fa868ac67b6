"""The mesh of the head: a grid round the head with loops round the eyes and the mouth.

The left half is built and mirrored. A block of the grid is taken out at the eye and at
the mouth, and rings go from its border to the rim of the lids and to the lips, over the
edge and on inside. Places on the skin come from `head_surface.head_field`.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from head_surface import EYE, EYE_RADIUS, LID_RADIUS, head_field
from numpy.typing import NDArray
from solids import Array, Ints, cast, curve, smoothstep

# Columns, in degrees from the nose round the left side to the nape; the eye's block
# lies between the first two of these, the mouth's between 0 and the middle one.
COLUMNS = np.array(
    [
        *(0, 2.3, 4.5, 6.6, 9.5, 13, 16.8, 20.7, 24.6, 28.4, 32.2, 35.8, 39.2, 42.5),
        *(48, 55, 63, 72, 81, 91, 101, 112, 123, 134, 145, 157, 168.5, 180),
    ]
)
EYE_COLUMNS, MOUTH_COLUMNS = (3, 13), (0, 8)
CROWN = np.array([83, 74, 65, 56, 47, 38.5, 30, 21.5, 13])  # degrees above the brow
EYE_ROWS = (9, 19)
MOUTH_ROWS = (26, 36)
# Front and back: row, distance from the axis, height and slope of the ray in degrees.
FRONT_ROWS = np.array(
    [
        [9, 0.090, 0.242, 3],
        [19, 0.090, 0.191, -4],
        [23, 0.100, 0.172, -12],
        [24, 0.102, 0.1665, -25],
        [26, 0.100, 0.1590, -30],
        [36, 0.095, 0.1230, -32],
        [39, 0.090, 0.1040, -45],
        [41, 0.078, 0.0980, -62],
        [43, 0.055, 0.0960, -62],
        [45, 0.045, 0.0820, -35],
        [52, 0.045, 0.0000, 0],
    ]
)
BACK_ROWS = np.array(
    [
        [9, 0.090, 0.242, 3],
        [19, 0.090, 0.195, -10],
        [26, 0.085, 0.162, -15],
        [36, 0.075, 0.118, -12],
        [41, 0.07, 0.088, -8],
        [45, 0.07, 0.062, 0],
        [52, 0.07, 0.000, 0],
    ]
)
ROWS = 53

EYE_RINGS = 7  # from the block to the rim
LID_HALF_WIDTH = np.radians(57)
UPPER_LID, LOWER_LID = np.radians(24), np.radians(20)  # above and below the corners
CANTHUS = np.radians(3)  # outer corner above the inner one
LID_GAP = 0.0004  # inside of the lids to the eyeball

MOUTH_HALF_WIDTH, MOUTH_HEIGHT = 0.0245, 0.1432
UPPER_LIP, LOWER_LIP = 0.0072, 0.0088
MOUTH_RINGS = 4  # from the block to the border of the lips
LIP_SHARES = np.array([0.0, 0.3, 0.6, 0.85, 1.0])
UPPER_BULGE = np.array([0.0003, 0.0017, 0.0028, 0.0025, 0.0006])
LOWER_BULGE = np.array([0.0000, 0.0022, 0.0038, 0.0032, 0.0006])
LIP_GAP = 0.00005
# Inside of the mouth: backwards, up or down, width.
POCKET = np.array(
    [
        [0.0040, 0.0001, 0.985],
        [0.0075, 0.0035, 1.00],
        [0.0100, 0.0120, 1.12],
        [0.0240, 0.0170, 1.16],
        [0.0420, 0.0150, 0.95],
        [0.0520, 0.0060, 0.50],
    ]
)


@dataclass(slots=True)
class Half:
    """The left half under construction.

    Attributes:
        points: ``(3,)`` each.
        faces: Four indices each.
        tags: Per point: part and numbers that shapes use.
    """

    points: list[Array] = field(default_factory=list)
    faces: list[list[int]] = field(default_factory=list)
    tags: list[tuple[str, float, float]] = field(default_factory=list)

    def add(self, points: Array, tags: list[tuple[str, float, float]]) -> Ints:
        """Return the indices of new points."""
        first = len(self.points)
        self.points += list(points)
        self.tags += tags
        return np.arange(first, len(self.points))

    def strip(self, a: Ints, b: Ints, closed: bool = False) -> None:
        """Join two rings of equal size by quads."""
        ends = len(a) if closed else len(a) - 1
        for i in range(ends):
            j = (i + 1) % len(a)
            self.faces.append([int(a[i]), int(b[i]), int(b[j]), int(a[j])])


def lid_point(a: Array, b: Array, radius: float | Array) -> Array:
    """Return points round the left eye from angle to the side and elevation."""
    a, b, radius = np.broadcast_arrays(a, b, radius)
    about = np.stack([np.sin(a), np.cos(a) * np.sin(b), np.cos(a) * np.cos(b)], axis=-1)
    return EYE + radius[..., None] * about


def lid_elevation(share: Array, upper: bool | NDArray[np.bool_]) -> Array:
    """Return the elevation of a lid's rim, at -1 the inner corner and 1 the outer."""
    bow = np.maximum(1 - share * share, 0.0)
    skew = 1 - 0.12 * share
    lift = np.where(upper, UPPER_LID * bow**0.62 * skew, -LOWER_LID * bow**0.75 / skew)
    return CANTHUS * share + lift


def grid_rays() -> tuple[Array, Array]:
    """Return starts and directions of the rays of the grid ``(R, C, 3)``."""
    theta = np.radians(COLUMNS)[None, :, None]
    rows = np.arange(9, ROWS)
    front = curve(FRONT_ROWS[:, 0], FRONT_ROWS[:, 1:], rows)[:, None]
    back = curve(BACK_ROWS[:, 0], BACK_ROWS[:, 1:], rows)[:, None]
    share = smoothstep(np.radians(35), np.radians(150), theta)
    low = front + (back - front) * share
    slope = np.radians(CROWN)
    crown = np.stack(
        [0.09 * np.cos(slope), 0.245 + 0.09 * np.sin(slope), CROWN], axis=-1
    )
    crown = np.broadcast_to(crown[:, None], (len(CROWN), len(COLUMNS), 3))
    table = np.concatenate([crown, low])
    radius, height, slope = table[..., 0], table[..., 1], np.radians(table[..., 2])
    turn = np.broadcast_to(theta[..., 0], radius.shape)
    side, ahead = np.sin(turn), np.cos(turn)
    # The axis of the neck leans back.
    axis = -0.03 * smoothstep(0.16, 0.06, height) * smoothstep(-90, -20, table[..., 2])
    through = np.stack([radius * side, height, axis + radius * ahead], axis=-1)
    outwards = np.stack(
        [side * np.cos(slope), np.sin(slope), ahead * np.cos(slope)], axis=-1
    )
    return through + 0.12 * outwards, -outwards


def on_skin(points: Array) -> Array:
    """Return points ``(V, 2)`` on the skin, seen from the front."""
    starts = np.column_stack([points, np.full(len(points), 0.16)])
    ahead = np.broadcast_to([0.0, 0.0, -1.0], starts.shape)
    return cast(head_field, starts, ahead, 0.2)


def block_border(grid: Ints, rows: tuple[int, int], columns: tuple[int, int]) -> Ints:
    """Return the border of a block, clockwise from the top left, closed."""
    r0, r1 = rows
    c0, c1 = columns
    top = grid[r0, c0:c1]
    right = grid[r0:r1, c1]
    bottom = grid[r1, c1:c0:-1]
    left = grid[r1:r0:-1, c0]
    return np.concatenate([top, right, bottom, left])


def add_eye(half: Half, grid: Ints) -> None:
    """Add the rings round the left eye and the inside of its lids."""
    border = block_border(grid, EYE_ROWS, EYE_COLUMNS)
    border = np.roll(border, (EYE_ROWS[1] - EYE_ROWS[0]) // 2)
    count = len(border)
    turn = 2 * np.pi * np.arange(count) / count
    share = -np.cos(turn)
    share[[0, count // 2]] = -1.0, 1.0
    upper = turn <= np.pi
    side, lift = LID_HALF_WIDTH * share, lid_elevation(share, upper)
    rim = lid_point(side, lift, LID_RADIUS)
    outer = np.array([half.points[i] for i in border])
    before = border
    mark = np.where(upper, 1.0, -1.0)
    mark[[0, count // 2]] = 0.0
    for k in range(1, EYE_RINGS):
        u = (k / EYE_RINGS) ** 0.8
        ring = on_skin((outer + u * (rim - outer))[:, :2])
        tags = [("skin", 0.0, 0.0)] * count
        now = half.add(ring, tags)
        half.strip(before, now, closed=True)
        before = now
    inside = (
        (1.0, LID_RADIUS),
        (1.0, LID_RADIUS - 0.0006),
        (1.015, EYE_RADIUS + LID_GAP),
        (1.18, EYE_RADIUS + LID_GAP),
        (1.45, EYE_RADIUS + LID_GAP),
    )
    middle = CANTHUS * share
    for k, (wider, radius) in enumerate(inside):
        ring = lid_point(side * wider, middle + (lift - middle) * wider, radius)
        part = "rim" if k == 0 else "lining"
        tags = [(part, float(m), float(s)) for m, s in zip(mark, share, strict=True)]
        now = half.add(ring, tags)
        half.strip(before, now, closed=True)
        before = now


def lip_line(x: Array) -> Array:
    """Return the height of the closed lips."""
    u = x / MOUTH_HALF_WIDTH
    return np.asarray(
        MOUTH_HEIGHT - 0.0006 * u * u + 0.0006 * np.exp(-((x / 0.004) ** 2))
    )


def add_mouth(half: Half, grid: Ints) -> None:
    """Add the rings round the mouth, the lips and the pocket behind them."""
    r0, r1 = MOUTH_ROWS
    c1 = MOUTH_COLUMNS[1]
    border = np.concatenate([grid[r0, :c1], grid[r0:r1, c1], grid[r1, c1::-1]])
    count = len(border)
    corner = count // 2
    turn = np.pi * np.arange(count) / (count - 1)
    x = MOUTH_HALF_WIDTH * np.sin(turn)
    x[[0, -1]] = 0.0
    u = np.clip(x / MOUTH_HALF_WIDTH, 0, 1)
    sign = np.sign(corner - np.arange(count)).astype(float)
    full = np.maximum(1 - u * u, 0.0) ** 0.62
    bow = (
        1
        - 0.16 * np.exp(-((x / 0.0030) ** 2))
        + 0.06 * np.exp(-(((x - 0.006) / 0.003) ** 2))
    )
    height = np.where(sign > 0, UPPER_LIP * bow, LOWER_LIP) * full
    line = lip_line(x)
    edge = np.column_stack([x, line + sign * height])
    outer = np.array([half.points[i] for i in border])
    before = border
    for k in range(1, MOUTH_RINGS):
        share = (k / MOUTH_RINGS) ** 0.85
        ring = on_skin(outer[:, :2] + share * (edge - outer[:, :2]))
        now = half.add(ring, [("skin", 0.0, 0.0)] * count)
        half.strip(before, now)
        before = now
    for share, up, down in zip(LIP_SHARES, UPPER_BULGE, LOWER_BULGE, strict=True):
        y = line + sign * np.maximum(height * (1 - share), LIP_GAP)
        ring = on_skin(np.column_stack([x, y]))
        bulge = np.where(sign > 0, up, down) * np.minimum(full * 1.15, 1.0)
        ring[:, 2] += bulge - 0.0012 * (1 - full) * share
        tags = [("lip", float(s), float(v)) for s, v in zip(sign, u, strict=True)]
        now = half.add(ring, tags)
        half.strip(before, now)
        before = now
    contact = ring
    tall = np.maximum(1 - u * u, 0.0) ** 0.25
    for back, open_, wide in POCKET:
        ring = contact + np.column_stack(
            [
                x * (wide - 1),
                sign * np.maximum(open_ * (tall if wide > 1 else full), LIP_GAP),
                np.full(count, -back),
            ]
        )
        ring[:, 2] += 0.004 * u * u * back / 0.05
        tags = [("pocket", float(s), float(v)) for s, v in zip(sign, u, strict=True)]
        now = half.add(ring, tags)
        half.strip(before, now)
        before = now
    half.strip(before[:corner], before[:corner:-1])
    half.faces.append(
        [int(before[corner + 1]), int(before[corner]), int(before[corner - 1]), -1]
    )


def half_head() -> Half:
    """Return the left half of the skin."""
    half = Half()
    starts, directions = grid_rays()
    hit = cast(head_field, starts.reshape(-1, 3), directions.reshape(-1, 3), 0.24)
    hit = hit.reshape(starts.shape)
    hit[:, [0, -1], 0] = 0.0
    inside = np.zeros(hit.shape[:2], bool)
    for rows, columns in (
        (EYE_ROWS, EYE_COLUMNS),
        (MOUTH_ROWS, (-1, MOUTH_COLUMNS[1])),
    ):
        inside[rows[0] + 1 : rows[1], columns[0] + 1 : columns[1]] = True
    grid = np.full(hit.shape[:2], -1)
    grid[~inside] = half.add(hit[~inside], [("skin", 0.0, 0.0)] * int((~inside).sum()))
    pole = half.add(
        cast(head_field, np.array([[0, 0.4, -0.01]]), np.array([[0.0, -1, 0]]), 0.2),
        [("skin", 0.0, 0.0)],
    )
    for c in range(len(COLUMNS) - 1):
        half.faces.append([int(pole[0]), int(grid[0, c]), int(grid[0, c + 1]), -1])
    eye, mouth = (EYE_ROWS, EYE_COLUMNS), (MOUTH_ROWS, MOUTH_COLUMNS)
    for r in range(ROWS - 1):
        for c in range(len(COLUMNS) - 1):
            if any(
                rows[0] <= r < rows[1] and cols[0] <= c < cols[1]
                for rows, cols in (eye, mouth)
            ):
                continue
            a, b = grid[r], grid[r + 1]
            half.faces.append([int(a[c]), int(b[c]), int(b[c + 1]), int(a[c + 1])])
    add_eye(half, grid)
    add_mouth(half, grid)
    return half
