"""The skin of the head as an implicit surface: smooth unions of simple solids.

Lengths are metres. Y is up, the face looks along +Z, the left side is +X. The surface
is its own mirror image: paired solids are written once, for the left.
"""

from __future__ import annotations

import numpy as np
from solids import Array, cone, cut, ellipsoid, join, length

EYE = np.array([0.0315, 0.215, 0.0735])  # centre of the left eyeball
EYE_RADIUS = 0.0150
LID_RADIUS = EYE_RADIUS + 0.0017  # outside of the lids
MIDDLE = 0.004  # half-width over which the two sides meet


def head_field(points: Array) -> Array:
    """Return the distance to the skin, negative inside ``(...)``."""
    passthrough = np.abs(points[..., :1])
    # Rounded in the middle, where a paired solid would meet its image in a crease.
    p = np.concatenate([np.sqrt(passthrough**2 + MIDDLE**2), points[..., 1:]], axis=-1)
    d = ellipsoid(p, (0, 0.250, -0.014), (0.0765, 0.088, 0.098))
    d = join(d, ellipsoid(p, (0, 0.255, 0.022), (0.062, 0.055, 0.070)), 0.03)
    d = join(d, ellipsoid(p, (0, 0.190, 0.016), (0.0690, 0.088, 0.0725)), 0.03)
    d = join(d, ellipsoid(p, (0, 0.150, 0.024), (0.0565, 0.049, 0.064)), 0.02)
    d = join(d, cone(p, (0, -0.06, -0.030), (0, 0.16, -0.020), 0.060, 0.056), 0.03)
    d = join(d, cone(p, (0.0, 0.010, -0.04), (0.17, -0.07, -0.04), 0.05, 0.055), 0.07)
    # Jaw line, chin and cheek bones.
    d = join(
        d, cone(p, (0.045, 0.140, 0.008), (0.016, 0.112, 0.064), 0.012, 0.014), 0.03
    )
    d = join(d, ellipsoid(p, (0, 0.1125, 0.0765), (0.020, 0.014, 0.0165)), 0.022)
    d = join(d, ellipsoid(p, (0.044, 0.184, 0.054), (0.022, 0.016, 0.022)), 0.035)
    d = join(d, ellipsoid(p, (0.034, 0.195, 0.066), (0.022, 0.014, 0.0185)), 0.022)
    # Brow and socket.
    d = join(
        d, cone(p, (0.012, 0.237, 0.083), (0.045, 0.239, 0.066), 0.008, 0.008), 0.02
    )
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
    lid = (
        length(np.concatenate([passthrough, points[..., 1:]], axis=-1) - EYE)
        - LID_RADIUS
    )
    return join(d, lid, 0.008)
