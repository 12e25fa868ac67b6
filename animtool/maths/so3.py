"""Unit quaternions (x, y, z, w): products, maps and interpolation.

Every function works over leading axes that broadcast. Rotations act on column
vectors: ``rotate(multiply(a, b), v) == rotate(a, rotate(b, v))``.
"""

from __future__ import annotations

import numpy as np

from animtool.core.array_types import ArrayLike, FloatArray

IDENTITY: FloatArray = np.array([0.0, 0.0, 0.0, 1.0])
IDENTITY.setflags(write=False)

# Below this angle [rad], sin(x)/x is 1 - x²/6 to float64 precision.
SMALL_ANGLE = 1e-5


# Unit vectors whose dot product is within this of -1 are opposite.
OPPOSITE_TOLERANCE = 1e-12


def multiply(a: ArrayLike, b: ArrayLike) -> FloatArray:
    """Return the product a·b: first b, then a. Shapes ``(..., 4)``.

    >>> quarter = from_axis_angle([0, 0, 1], np.pi / 2)
    >>> np.allclose(multiply(quarter, quarter), [0, 0, 1, 0])
    True
    """
    a, b = np.asarray(a, np.float64), np.asarray(b, np.float64)
    ax, ay, az, aw = a[..., 0], a[..., 1], a[..., 2], a[..., 3]
    bx, by, bz, bw = b[..., 0], b[..., 1], b[..., 2], b[..., 3]
    # Stacking the components would double the time.
    x = aw * bx + ax * bw + ay * bz - az * by
    product = np.empty((*x.shape, 4))
    product[..., 0] = x
    product[..., 1] = aw * by - ax * bz + ay * bw + az * bx
    product[..., 2] = aw * bz + ax * by - ay * bx + az * bw
    product[..., 3] = aw * bw - ax * bx - ay * by - az * bz
    return product


def conjugate(q: ArrayLike) -> FloatArray:
    """Return the inverse of unit quaternions ``(..., 4)``.

    >>> conjugate([0.6, 0, 0, 0.8]).tolist()
    [-0.6, -0.0, -0.0, 0.8]
    """
    return np.asarray(np.asarray(q, np.float64) * [-1.0, -1.0, -1.0, 1.0])


def normalize(q: ArrayLike) -> FloatArray:
    """Normalize quaternions ``(..., 4)``; a zero quaternion becomes the identity.

    >>> normalize([0, 0, 0, 2]).tolist()
    [0.0, 0.0, 0.0, 1.0]
    """
    q = np.asarray(q, np.float64)
    # Scaled first, so that tiny and huge values neither underflow nor overflow.
    scale = np.abs(q).max(axis=-1, keepdims=True)
    scaled_q = q / np.where(scale > 0, scale, 1.0)
    length = np.linalg.norm(scaled_q, axis=-1, keepdims=True)
    return np.where(scale > 0, scaled_q / np.where(length > 0, length, 1.0), IDENTITY)


def rotate(q: ArrayLike, v: ArrayLike) -> FloatArray:
    """Return vectors ``(..., 3)`` rotated by unit quaternions ``(..., 4)``.

    >>> np.allclose(rotate(from_axis_angle([0, 0, 1], np.pi / 2), [1, 0, 0]), [0, 1, 0])
    True
    """
    q, v = np.asarray(q, np.float64), np.asarray(v, np.float64)
    axis, w = q[..., :3], q[..., 3:]
    twice_cross = 2.0 * cross(axis, v)
    return np.asarray(v + w * twice_cross + cross(axis, twice_cross))


def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return cross products ``(..., 3)``, with less overhead than `numpy.cross`."""
    ax, ay, az = a[..., 0], a[..., 1], a[..., 2]
    bx, by, bz = b[..., 0], b[..., 1], b[..., 2]
    x = ay * bz - az * by
    product = np.empty((*x.shape, 3))
    product[..., 0] = x
    product[..., 1] = az * bx - ax * bz
    product[..., 2] = ax * by - ay * bx
    return product


def from_axis_angle(axis: ArrayLike, angle: ArrayLike) -> FloatArray:
    """Return rotations by angles ``(...)`` [rad] about unit axes ``(..., 3)``.

    >>> from_axis_angle([1, 0, 0], np.pi).round(12).tolist()
    [1.0, 0.0, 0.0, 0.0]
    """
    axis = np.asarray(axis, np.float64)
    half_angle = np.asarray(angle, np.float64)[..., None] / 2
    vector = axis * np.sin(half_angle)
    w = np.broadcast_to(np.cos(half_angle), (*vector.shape[:-1], 1))
    return np.concatenate([vector, w], axis=-1)


def shortest_rotation(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the shortest rotation from a unit vector ``(3,)`` to another.

    >>> shortest_rotation(np.array([1.0, 0, 0]), np.array([-1.0, 0, 0])).tolist()
    [0.0, 1.0, 0.0, 0.0]
    """
    scalar = 1.0 + float(a @ b)
    if scalar < OPPOSITE_TOLERANCE:
        perpendicular = np.eye(3)[int(np.argmin(np.abs(a)))]
        return normalize(np.append(perpendicular - (perpendicular @ a) * a, 0.0))
    return normalize(np.append(cross(a, b), scalar))


def exp(vector: ArrayLike) -> FloatArray:
    """Return the rotation of a rotation vector ``(..., 3)`` [rad].

    >>> exp([0, 0, 0]).tolist()
    [0.0, 0.0, 0.0, 1.0]
    """
    vector = np.asarray(vector, np.float64)
    angle = np.linalg.norm(vector, axis=-1, keepdims=True)
    is_small = angle < SMALL_ANGLE
    ratio = np.sin(angle / 2) / np.where(is_small, 1.0, angle)
    factor = np.where(is_small, 0.5 - angle**2 / 48, ratio)
    return np.concatenate([vector * factor, np.cos(angle / 2)], axis=-1)


def log(q: ArrayLike) -> FloatArray:
    """Return the shortest rotation vector ``(..., 3)`` [rad] of unit quaternions.

    The length is at most π; q and -q give the same vector, up to its sign at π.

    >>> log([0, 0, 0, -1]).tolist()
    [0.0, 0.0, 0.0]
    """
    q = np.asarray(q, np.float64)
    q = np.where(q[..., 3:] < 0, -q, q)
    length = np.linalg.norm(q[..., :3], axis=-1, keepdims=True)
    w = q[..., 3:]
    is_small = length < SMALL_ANGLE
    series = 2.0 / w.clip(min=0.5) * (1 - (length / w.clip(min=0.5)) ** 2 / 3)
    ratio = 2.0 * np.arctan2(length, w) / np.where(is_small, 1.0, length)
    return np.asarray(q[..., :3] * np.where(is_small, series, ratio) + 0.0)


def steps(q: FloatArray) -> FloatArray:
    """Return the shortest rotation vectors ``(F - 1, A, 3)`` [rad] from frame to frame.

    They are about the body's axes: ``q[f + 1]`` is ``q[f]`` times their rotation.

    >>> rotations = from_axis_angle([0, 0, 1], [[0.0], [0.5], [0.25]])
    >>> steps(rotations)[:, 0, 2].round(12).tolist()
    [0.5, -0.25]
    """
    from animtool import _kernels

    return _kernels.rotation_steps(np.ascontiguousarray(q))


def angle_between(a: ArrayLike, b: ArrayLike) -> FloatArray:
    """Return the angle ``(...)`` [rad] of the rotation between unit quaternions.

    Exact for small angles, where the arc cosine of the dot product is not
    (W. Kahan, How futile are mindless assessments of roundoff, 2006, section 12).

    >>> float(angle_between([0, 0, 0, 1], [0, 0, 0, -1]))
    0.0
    """
    a, b = np.asarray(a, np.float64), np.asarray(b, np.float64)
    distance = np.linalg.norm(a - b, axis=-1)
    negated_distance = np.linalg.norm(a + b, axis=-1)
    shorter_distance = np.minimum(distance, negated_distance)
    longer_distance = np.maximum(distance, negated_distance)
    return np.asarray(4.0 * np.arctan2(shorter_distance, longer_distance))


def slerp(a: ArrayLike, b: ArrayLike, t: ArrayLike) -> FloatArray:
    """Return the shortest-arc interpolation of unit quaternions at t ``(...)`` [1].

    At rotations 180 degrees apart the arc is not unique; that of the quaternions' signs
    is used.

    References:
        K. Shoemake, Animating rotation with quaternion curves, 1985.

    >>> half = slerp([0, 0, 0, 1], [0, 0, 1, 0], 0.5)
    >>> np.allclose(half, [0, 0, 0.5**0.5, 0.5**0.5])
    True
    """
    # Imported here because reading rigs needs no kernels.
    from animtool import _kernels

    a, b = np.asarray(a, np.float64), np.asarray(b, np.float64)
    t = np.asarray(t, np.float64)
    shape = np.broadcast_shapes(a.shape[:-1], b.shape[:-1], t.shape)
    starts, ends = (
        np.ascontiguousarray(q if q.size == 4 else np.broadcast_to(q, (*shape, 4)))
        for q in (a, b)
    )
    fractions = np.broadcast_to(t, shape).ravel()
    rotations = _kernels.slerp(starts.reshape(-1, 4), ends.reshape(-1, 4), fractions)
    return rotations.reshape(*shape, 4)


def align_signs(q: ArrayLike, previous: ArrayLike | None = None) -> FloatArray:
    """Return quaternions ``(F, ..., 4)`` with signs continuous along the first axis.

    The first gets the sign nearest to ``previous`` ``(..., 4)``, default identity.

    >>> align_signs([[0, 0, 0, -1], [0, 0, 0, 1]])[:, 3].tolist()
    [1.0, 1.0]
    """
    q = np.asarray(q, np.float64)
    if not len(q):
        return q.copy()
    previous = IDENTITY if previous is None else previous
    first_reference = np.broadcast_to(previous, q.shape[1:])
    dots = np.sum(q * np.concatenate([first_reference[None], q[:-1]]), axis=-1)
    signs = np.cumprod(np.where(dots < 0, -1.0, 1.0), axis=0)
    return np.asarray(q * signs[..., None])


def align_to(q: ArrayLike, reference: ArrayLike) -> FloatArray:
    """Return quaternions ``(..., 4)`` in the same hemisphere as other quaternions.

    >>> align_to([[0, 0, 0, -1.0]], [[0, 0, 0.6, 0.8]])[:, 3].tolist()
    [1.0]
    """
    q = np.asarray(q, np.float64)
    dots = np.sum(q * np.asarray(reference), axis=-1, keepdims=True)
    return np.where(dots < 0, -q, q)


def to_matrix(q: ArrayLike) -> FloatArray:
    """Return rotation matrices ``(..., 3, 3)`` of unit quaternions.

    >>> to_matrix([0, 0, 0, 1]).tolist()
    [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
    """
    return np.stack([rotate(q, axis) for axis in np.eye(3)], axis=-1)


def from_matrix(matrix: ArrayLike) -> FloatArray:
    """Return unit quaternions ``(..., 4)``, w ≥ 0, of rotation matrices.

    The largest of the four squared components is the pivot, so that the division
    is never by less than one (S. W. Shepperd, Quaternion from rotation matrix,
    1978). The matrix must be a rotation: no scale, no mirror.

    >>> from_matrix(np.diag([1.0, -1.0, -1.0])).tolist()
    [1.0, 0.0, 0.0, 0.0]
    """
    m = np.asarray(matrix, np.float64)
    trace = np.trace(m, axis1=-2, axis2=-1)
    diagonal = np.diagonal(m, axis1=-2, axis2=-1)
    pivots = np.concatenate([diagonal, trace[..., None]], axis=-1).argmax(axis=-1)
    rows = []
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        row: list[FloatArray] = [trace] * 4
        row[i] = 1 + m[..., i, i] - m[..., j, j] - m[..., k, k]
        row[j] = m[..., i, j] + m[..., j, i]
        row[k] = m[..., i, k] + m[..., k, i]
        row[3] = m[..., k, j] - m[..., j, k]
        rows.append(np.stack(row, axis=-1))
    row = [m[..., 2, 1] - m[..., 1, 2], m[..., 0, 2] - m[..., 2, 0]]
    row += [m[..., 1, 0] - m[..., 0, 1], 1 + trace]
    rows.append(np.stack(row, axis=-1))
    candidates = np.stack(rows, axis=-2)
    chosen_rows = np.take_along_axis(candidates, pivots[..., None, None], axis=-2)
    q = normalize(chosen_rows[..., 0, :])
    return np.where(q[..., 3:] < 0, -q, q) + 0.0


def nearest_rotations(matrices: FloatArray) -> FloatArray:
    """Return the rotation matrices nearest to matrices ``(..., 3, 3)``.

    Applied to the covariance of two point sets, it gives their best-fit rotation.

    References:
        W. Kabsch, A solution for the best rotation to relate two sets of vectors, 1976.

    >>> nearest_rotations(np.diag([3.0, 2.0, -1.0])).tolist()
    [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
    """
    left, _, right = np.linalg.svd(matrices)
    left[..., 2] *= np.sign(np.linalg.det(left @ right))[..., None]
    return np.asarray(left @ right)


def split_scale(linear: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Split linear maps ``(..., 3, 3)`` into rotations and scales, ``L = R·S``.

    A mirror becomes a negative scale on all three axes. Shear is left out.

    Returns unit quaternions ``(..., 4)``, and scales ``(..., 3)``: the lengths of the
    columns.

    >>> rotation, scale = split_scale(np.diag([2.0, 1.0, -1.0]))
    >>> rotation.tolist(), scale.tolist()
    ([0.0, 0.0, 1.0, 0.0], [-2.0, -1.0, -1.0])
    """
    linear = np.asarray(linear, np.float64)
    scales = np.linalg.norm(linear, axis=-2)
    is_mirrored = np.linalg.det(linear) < 0
    scales = np.where(is_mirrored[..., None], -scales, scales)
    divisor = np.where(scales == 0, 1.0, scales)[..., None, :]
    return from_matrix(linear / divisor), scales
