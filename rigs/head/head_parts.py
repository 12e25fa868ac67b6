"""What stands beside the skin: ears, brows, hair, eyeballs, teeth and tongue."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from head_mesh import on_skin
from head_surface import EYE, EYE_RADIUS, head_field
from solids import Array, Ints, cast, project, smoothstep

# Ear: share of the outline, height over the head.
EAR_RINGS = np.array(
    [
        [0.55, -0.0100],
        [0.86, -0.0030],
        [0.98, 0.0030],
        [1.00, 0.0062],
        [0.95, 0.0084],
        [0.88, 0.0080],
        [0.81, 0.0050],
        [0.72, 0.0042],
        [0.62, 0.0060],
        [0.52, 0.0048],
        [0.42, -0.0010],
        [0.24, -0.0035],
    ]
)
EAR_PLACE = np.array([0.0700, 0.1950, -0.0120])
EAR_COUNT = 28

EYE_RINGS = np.radians(
    [4, 8, 10.5, 11.5, 15, 19, 22.5, 24, 25.5, 33, 44, 57, 72, 90, 110, 135, 160]
)
EYE_COUNT = 28
PUPIL, IRIS = np.radians(10.9), np.radians(23.5)

ARCH_WIDTH, ARCH_DEPTH, ARCH_FRONT = 0.0240, 0.034, 0.0845
TEETH = 14  # in a row
GUM = 0.0042  # [m] height of what is seen of it
UPPER_TEETH = (0.1525, 0.1392)
LOWER_TEETH = (0.1390, 0.1280)

# The middle of the left brow from the front, and half its height.
BROW_X = (0.0085, 0.020, 0.032, 0.043, 0.053)
BROW_Y = (0.2370, 0.2400, 0.2425, 0.2405, 0.2350)
BROW_HALF = (0.0030, 0.0034, 0.0030, 0.0022, 0.0006)

# Hair: degrees round the head from the front, and of the hairline above the middle.
HAIRLINE = np.array(
    [
        *((0, 30), (18, 31), (32, 34), (46, 22), (58, 4), (68, -18), (76, -30)),
        *((84, -26), (92, -12), (104, -14), (116, -26), (130, -36), (150, -40)),
        (180, -42),
    ]
)
HAIR_MIDDLE, HAIR_COLUMNS, HAIR_LEVEL = np.array([0.0, 0.25, -0.012]), 46, 0.0055
# Share of the way to the crown, height over the skin.
HAIR_RINGS = (
    *((0.0, -0.001), (0.025, 0.0035), (0.07, HAIR_LEVEL), (0.15, HAIR_LEVEL)),
    *(
        (share, HAIR_LEVEL)
        for share in (0.23, 0.31, 0.39, 0.47, 0.55, 0.63, 0.71, 0.79, 0.87, 0.94)
    ),
)

TONGUE_TIP, TONGUE_LENGTH, TONGUE_WIDTH = 0.0775, 0.045, 0.0165
TONGUE_HEIGHT, TONGUE_THICKNESS = 0.1365, 0.0045


@dataclass(frozen=True, slots=True)
class Piece:
    """A part with its own points.

    Attributes:
        points: ``(V, 3)``.
        faces: ``(N, 4)``, -1 filling triangles.
    """

    points: Array
    faces: Ints


def lofted(rings: Array, tip: Array | None = None, first: Array | None = None) -> Piece:
    """Return closed rings ``(R, C, 3)`` joined by quads, fans at the ends if given."""
    count, width = rings.shape[:2]
    points = rings.reshape(-1, 3)
    faces = []
    for r in range(count - 1):
        for c in range(width):
            d = (c + 1) % width
            faces.append(
                [r * width + c, (r + 1) * width + c, (r + 1) * width + d, r * width + d]
            )
    for end, ring in ((tip, count - 1), (first, 0)):
        if end is None:
            continue
        points = np.concatenate([points, end[None]])
        for c in range(width):
            a, b = ring * width + c, ring * width + (c + 1) % width
            pair = [b, a] if ring else [a, b]
            faces.append([*pair, len(points) - 1, -1])
    return Piece(points, np.array(faces))


def ear() -> Piece:
    """Return the left ear."""
    turn = 2 * np.pi * np.arange(EAR_COUNT) / EAR_COUNT
    up, back = np.cos(turn), np.sin(turn)
    wide = np.where(up > 0, 0.0175, 0.0175 - 0.0065 * up**2)
    wide = np.where(back < 0, wide * (0.62 - 0.1 * up), wide)
    outline = np.column_stack([np.zeros(EAR_COUNT), 0.0285 * up, -wide * back])
    rings = []
    for share, height in EAR_RINGS:
        inner = np.clip((0.7 - share) / 0.5, 0, 1)
        ring = outline * share + [0.0, -0.002 * inner, 0.002 * inner]
        lobe = smoothstep(0.5, 0.95, -up) * smoothstep(0.4, 0.75, share)
        lift = height * (1 - 0.55 * lobe) + 0.002 * lobe * (share < 0.97)
        front_ = smoothstep(0.2, 0.9, -back) * smoothstep(0.6, 0.9, share)
        lift = lift - 0.0035 * front_ * (height > 0)
        ring[:, 0] = lift + 0.22 * np.maximum(-ring[:, 2] + 0.004, 0)
        rings.append(ring)
    made = lofted(np.array(rings), np.array([-0.0030, -0.002, 0.002]))
    lean, flare = np.radians(10), np.radians(2)
    c, s = np.cos(lean), np.sin(lean)
    turned = made.points @ np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
    c, s = np.cos(flare), np.sin(flare)
    turned = turned @ np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    return Piece(turned + EAR_PLACE, made.faces)


def eyeball() -> Piece:
    """Return the left eyeball, rings about its gaze."""
    turn = 2 * np.pi * (np.arange(EYE_COUNT) + 0.5) / EYE_COUNT
    rings = [
        EYE
        + EYE_RADIUS
        * np.column_stack(
            [
                np.sin(a) * np.cos(turn),
                np.sin(a) * np.sin(turn),
                np.full(EYE_COUNT, np.cos(a)),
            ]
        )
        for a in EYE_RINGS
    ]
    ends = EYE + EYE_RADIUS * np.array([[0, 0, -1.0], [0, 0, 1.0]])
    return lofted(np.array(rings), ends[0], ends[1])


def teeth(top: float, bottom: float, shrink: float) -> Piece:
    """Return a row of teeth, each a bulge with grooves between."""
    count = TEETH * 6
    along = np.linspace(-1, 1, count + 1)
    turn = np.radians(80) * along
    phase = np.abs(np.sin(np.pi * np.linspace(0, TEETH, count + 1)))
    bulge = 0.0009 * np.sqrt(phase) - 0.0009
    rings = []
    upper = top > bottom and shrink == 1.0
    bite = 0.0006 * (1 - np.sqrt(phase)) * (1 if upper else -1)
    neck = top - GUM if upper else bottom + GUM
    fold = 0.0006 if upper else -0.0006
    heights = (
        (top, neck, neck - fold, bottom) if upper else (top, neck + fold, neck, bottom)
    )
    profile = [(top, -0.005), (top, 0.0), *((h, 0.0004) for h in heights[1:3])]
    profile += [(bottom, -0.0004), (bottom, -0.0035), (top, -0.005)]
    for height, out in profile:
        y = np.full(count + 1, height)
        grown = bulge * (out > -0.002)
        edge = (height == bottom) if upper else (height == top)
        y = y + bite * edge
        x = (ARCH_WIDTH * shrink + out + grown) * np.sin(turn)
        z = (
            ARCH_FRONT
            - ARCH_DEPTH
            + (ARCH_DEPTH - 0.002 * (shrink != 1.0) + out + grown) * np.cos(turn)
        )
        rings.append(np.column_stack([x, y, z]))
    grid = np.array(rings)
    points = grid.reshape(-1, 3)
    faces = []
    width = count + 1
    for r in range(len(profile) - 1):
        for c in range(count):
            a = r * width + c
            faces.append([a, a + width, a + width + 1, a + 1])
    return Piece(points, np.array(faces))


def tongue() -> Piece:
    """Return the tongue, rings from its root to its tip."""
    count, rings = 16, []
    turn = -2 * np.pi * np.arange(count) / count
    across, lift = np.cos(turn), np.sin(turn)
    across[np.abs(across) < 1e-12] = 0.0
    for share in (0.0, 0.15, 0.3, 0.45, 0.6, 0.72, 0.82, 0.9, 0.955, 0.99):
        z = TONGUE_TIP - TONGUE_LENGTH * (1 - share)
        round_ = np.sqrt(max(1 - (max(share - 0.45, 0) / 0.55) ** 2.4, 0.0))
        groove = 0.0012 * np.exp(-((across / 0.25) ** 2)) * (lift > 0) * round_
        x = TONGUE_WIDTH * (0.85 + 0.15 * share) * round_ * across
        y = (
            TONGUE_HEIGHT
            - 0.004 * (1 - share) ** 2
            + TONGUE_THICKNESS * round_ * lift
            - groove
        )
        rings.append(np.column_stack([x, y, np.full(count, z)]))
    return lofted(np.array(rings), np.array([0.0, TONGUE_HEIGHT, TONGUE_TIP]))


def brow() -> Piece:
    """Return the left brow, a strip that lies on the skin."""
    count = 26
    x = np.linspace(BROW_X[0], BROW_X[-1], count)
    middle, half = np.interp(x, BROW_X, BROW_Y), np.interp(x, BROW_X, BROW_HALF)
    smooth = np.array([0.25, 0.5, 0.25])
    for _ in range(6):
        middle[1:-1] = np.convolve(middle, smooth, "valid")
        half[1:-1] = np.convolve(half, smooth, "valid")
    rows = []
    for across, level in zip(
        (-1.0, -0.5, 0.0, 0.5, 1.0),
        (-0.0004, 0.0006, 0.0010, 0.0006, -0.0004),
        strict=True,
    ):
        lean = 0.0015 * across
        front = np.column_stack([x + lean, middle + across * half])
        on = on_skin(front)
        rows.append(project(head_field, on, level, 6))
    return sheet(rows)


def hair() -> Piece:
    """Return the left half of the hair, a cap from the hairline to the crown."""
    turn = np.radians(np.linspace(0, 180, HAIR_COLUMNS))
    low = np.radians(np.interp(np.degrees(turn), *HAIRLINE.T))
    smooth = np.array([0.25, 0.5, 0.25])
    for _ in range(2):
        low[1:-1] = np.convolve(low, smooth, "valid")
    rows = []
    for share, level in HAIR_RINGS:
        lift = low + share * (np.pi / 2 - low)
        out = np.column_stack(
            [np.cos(lift) * np.sin(turn), np.sin(lift), np.cos(lift) * np.cos(turn)]
        )
        on = cast(head_field, HAIR_MIDDLE + 0.2 * out, -out, 0.2)
        ring = project(head_field, on, level, 6)
        ring[[0, -1], 0] = 0.0
        rows.append(ring)
    top = project(head_field, HAIR_MIDDLE[None] * [1, 1.35, 1], HAIR_LEVEL, 6)
    made = sheet(rows)
    last = (len(rows) - 1) * HAIR_COLUMNS
    pole = len(made.points)
    fan = [[last + c, last + c + 1, pole, -1] for c in range(HAIR_COLUMNS - 1)]
    return Piece(
        np.concatenate([made.points, top * [0, 1, 1]]),
        np.concatenate([made.faces, fan]),
    )


def sheet(rows: list[Array]) -> Piece:
    """Return rows of points joined by quads."""
    count = len(rows[0])
    faces = [
        [r * count + c, r * count + c + 1, (r + 1) * count + c + 1, (r + 1) * count + c]
        for r in range(len(rows) - 1)
        for c in range(count - 1)
    ]
    return Piece(np.concatenate(rows), np.array(faces))
