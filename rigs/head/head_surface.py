"""The skin of the head as an implicit surface: smooth unions of simple solids.

Lengths are metres. Y is up, the face looks along +Z and the left side is +X; the surface
is its own mirror image, so paired solids are written once, for the left.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Field = Callable[[Array], Array]

EYE = np.array([0.0315, 0.215, 0.0735])  # centre of the left eyeball
EYE_RADIUS = 0.0150
LID_RADIUS = EYE_RADIUS + 0.0017  # outside of the lids
MIDDLE = 0.004  # half-width over which the two sides meet


def length(vectors: Array) -> Array:
    """Return the lengths of vectors ``(..., 3)``."""
    return np.sqrt((vectors**2).sum(-1))


def smoothstep(low: ArrayLike, high: ArrayLike, x: ArrayLike) -> Array:
    """Return the cubic step from 0 at low to 1 at high."""
    low, high, x = np.asarray(low), np.asarray(high), np.asarray(x)
    u = np.clip((x - low) / (high - low), 0.0, 1.0)
    return np.asarray(u * u * (3 - 2 * u))


def join(a: Array, b: Array, blend: float) -> Array:
    """Return the union of two solids, rounded where they meet over a width."""
    h = np.maximum(blend - np.abs(a - b), 0.0) / blend
    return np.minimum(a, b) - h * h * h * blend / 6


def cut(a: Array, b: Array, blend: float) -> Array:
    """Return the first solid without the second."""
    return -join(-a, b, blend)


def ellipsoid(points: Array, centre: ArrayLike, radii: ArrayLike) -> Array:
    """Return the distance to an ellipsoid along the axes, exact to first order."""
    radii = np.asarray(radii, np.float64)
    scaled = (points - np.asarray(centre)) / radii
    k0 = length(scaled)
    k1 = length(scaled / radii)
    return np.asarray(k0 * (k0 - 1.0) / np.maximum(k1, 1e-9))


def cone(points: Array, a: ArrayLike, b: ArrayLike, ra: float, rb: float) -> Array:
    """Return the distance to a capsule whose radius goes from one end's to another's."""
    a, b = np.asarray(a, np.float64), np.asarray(b, np.float64)
    axis = b - a
    along = np.clip((points - a) @ axis / (axis @ axis), 0.0, 1.0)
    near = a + along[..., None] * axis
    return length(points - near) - (ra + (rb - ra) * along)


def head_field(points: Array) -> Array:
    """Return the distance to the skin, negative inside ``(...)``."""
    aside = np.abs(points[..., :1])
    # Rounded in the middle, where a paired solid would meet its image in a crease.
    p = np.concatenate([np.sqrt(aside**2 + MIDDLE**2), points[..., 1:]], axis=-1)
    d = ellipsoid(p, (0, 0.250, -0.014), (0.0765, 0.088, 0.098))
    d = join(d, ellipsoid(p, (0, 0.255, 0.022), (0.062, 0.055, 0.070)), 0.03)
    d = join(d, ellipsoid(p, (0, 0.190, 0.016), (0.0690, 0.088, 0.0725)), 0.03)
    d = join(d, ellipsoid(p, (0, 0.150, 0.024), (0.0565, 0.049, 0.064)), 0.02)
    d = join(d, cone(p, (0, -0.06, -0.030), (0, 0.16, -0.020), 0.060, 0.056), 0.03)
    d = join(d, cone(p, (0.0, 0.010, -0.04), (0.17, -0.07, -0.04), 0.05, 0.055), 0.07)
    # Jaw line, chin and cheek bones.
    d = join(d, cone(p, (0.045, 0.140, 0.008), (0.016, 0.112, 0.064), 0.012, 0.014), 0.03)
    d = join(d, ellipsoid(p, (0, 0.1125, 0.0765), (0.020, 0.014, 0.0165)), 0.022)
    d = join(d, ellipsoid(p, (0.044, 0.184, 0.054), (0.022, 0.016, 0.022)), 0.035)
    d = join(d, ellipsoid(p, (0.034, 0.195, 0.066), (0.022, 0.014, 0.0185)), 0.022)
    # Brow and socket.
    d = join(d, cone(p, (0.012, 0.237, 0.083), (0.045, 0.239, 0.066), 0.008, 0.008), 0.02)
    d = cut(d, ellipsoid(p, (0.0295, 0.217, 0.105), (0.019, 0.0100, 0.0170)), 0.018)
    # Muzzle.
    d = join(d, ellipsoid(p, (0, 0.146, 0.068), (0.032, 0.024, 0.0255)), 0.02)
    # Nose: bridge, tip, wings, nostrils.
    d = join(d, cone(p, (0, 0.226, 0.084), (0, 0.178, 0.106), 0.0075, 0.0095), 0.02)
    d = join(d, ellipsoid(p, (0, 0.1735, 0.110), (0.0100, 0.0090, 0.0100)), 0.010)
    d = join(d, ellipsoid(p, (0.0110, 0.1705, 0.0985), (0.0075, 0.0078, 0.0105)), 0.008)
    d = cut(d, ellipsoid(p, (0.0062, 0.1630, 0.105), (0.0034, 0.0038, 0.0060)), 0.004)
    # Philtrum and the fold under the lip.
    d = cut(d, cone(p, (0, 0.1625, 0.1025), (0, 0.153, 0.1015), 0.003, 0.004), 0.008)
    d = cut(d, ellipsoid(p, (0, 0.1275, 0.1015), (0.018, 0.0045, 0.007)), 0.012)
    # Lids, over the eyeball.
    lid = length(np.concatenate([aside, points[..., 1:]], axis=-1) - EYE) - LID_RADIUS
    return join(d, lid, 0.008)


def gradient(field: Field, points: Array) -> Array:
    """Return unit gradients of a field ``(V, 3)``."""
    step = 1e-5
    slopes = [
        field(points + step * axis) - field(points - step * axis) for axis in np.eye(3)
    ]
    made = np.stack(slopes, axis=-1)
    return np.asarray(made / np.maximum(length(made), 1e-12)[..., None])


def project(field: Field, points: Array, level: ArrayLike = 0.0, steps: int = 4) -> Array:
    """Return points moved along the gradient to a level of a field."""
    for _ in range(steps):
        step = 1e-5
        slopes = np.stack(
            [
                (field(points + step * a) - field(points - step * a)) / (2 * step)
                for a in np.eye(3)
            ],
            axis=-1,
        )
        square = np.maximum((slopes**2).sum(-1), 0.05)
        points = points - ((field(points) - level) / square)[..., None] * slopes
    return points


def cast(field: Field, starts: Array, directions: Array, reach: float) -> Array:
    """Return where rays from outside first meet the skin ``(V, 3)``."""
    gone = np.zeros(len(starts))
    for _ in range(40):
        here = starts + gone[:, None] * directions
        gone = np.minimum(gone + 0.85 * field(here), reach)
    return starts + gone[:, None] * directions


def falloff(points: Array, centre: ArrayLike, radii: ArrayLike) -> Array:
    """Return a bump: 1 at the centre, 0 and smooth from the radii outwards."""
    square = (((points - np.asarray(centre)) / np.asarray(radii)) ** 2).sum(-1)
    return np.asarray(np.maximum(1 - square, 0.0) ** 2)


def curve(knots: Sequence[float], values: ArrayLike, x: ArrayLike) -> Array:
    """Return piecewise linear values, for tables ``(K,)`` or ``(K, D)``."""
    table = np.asarray(values, np.float64)
    if table.ndim == 1:
        return np.asarray(np.interp(x, knots, table))
    return np.stack([np.interp(x, knots, column) for column in table.T], axis=-1)
