from __future__ import annotations

import numpy as np
import pytest
from support.clips import channel_of

from animtool.clip.channels import ClipChannel, component_curves
from animtool.core.array_types import ArrayLike, FloatArray
from animtool.maths import tangents
from animtool.maths.curves import Interp, SegmentKind, evaluate
from animtool.maths.tangents import Parametrization, Tangent

TIMES = [0.0, 1.0, 4.0, 6.0, 11.0]
VALUES = [0.0, 2.0, 1.0, 1.5, -3.0]
U = np.linspace(0, 1, 17)


def along(channel: ClipChannel, k: int) -> FloatArray:
    """Return values ``(17, D)`` evenly through the segment behind a key."""
    times = channel.times[k] + U * (channel.times[k + 1] - channel.times[k])
    return evaluate(component_curves([channel]), times).T


def hermite(k: int, out: float, into: float) -> FloatArray:
    """Return the cubic with slopes at the ends of the segment behind a key."""
    h, a, b = TIMES[k + 1] - TIMES[k], VALUES[k], VALUES[k + 1]
    u = U
    rising = u * u * (3 - 2 * u)
    bent = h * (u * (1 - u) ** 2 * out - u * u * (1 - u) * into)
    return np.asarray(a + (b - a) * rising + bent)[:, None]


def assert_slopes(channel: ClipChannel, ins: ArrayLike, outs: ArrayLike) -> None:
    before, behind = np.ravel(ins), np.ravel(outs)
    for k in range(len(TIMES) - 1):
        expected = hermite(k, behind[k], before[k + 1])
        np.testing.assert_allclose(along(channel, k), expected, rtol=0, atol=1e-14)
    assert (component_curves([channel]).kinds[:-1] == SegmentKind.CUBIC).all()


def bezier(points: ArrayLike, times: FloatArray) -> FloatArray:
    """Return values of a Bezier segment at times, its parameter by bisection."""
    (t0, v0), (t1, v1), (t2, v2), (t3, v3) = np.asarray(points, np.float64)

    def cubic(u: FloatArray, a: float, b: float, c: float, d: float) -> FloatArray:
        w = 1 - u
        return np.asarray(w**3 * a + 3 * w * w * u * b + 3 * w * u * u * c + u**3 * d)

    low, high = np.zeros(times.shape), np.ones(times.shape)
    for _ in range(80):
        middle = (low + high) / 2
        early = cubic(middle, t0, t1, t2, t3) < times
        low, high = np.where(early, middle, low), np.where(early, high, middle)
    return cubic((low + high) / 2, v0, v1, v2, v3)


def test_linear_and_step() -> None:
    straight = channel_of(TIMES, VALUES, Interp.LINEAR)
    stepped = channel_of(TIMES, VALUES, Interp.STEP)
    at = np.linspace(-1, 12, 131)
    found = evaluate(component_curves([straight, stepped]), at)
    np.testing.assert_allclose(found[0], np.interp(at, TIMES, VALUES), atol=1e-15)
    index = np.clip(np.searchsorted(TIMES, at, side="right") - 1, 0, None)
    np.testing.assert_array_equal(found[1], np.array(VALUES)[index])


@pytest.mark.parametrize(
    ("out", "into"),
    [((2, 5), (-1, 3)), ((0, 0), (0, 0)), ((4, -9), (-4, 9)), ((0, 7), (-3, 0))],
)
def test_bezier_with_handles_of_its_own(
    out: tuple[float, float], into: tuple[float, float]
) -> None:
    channel = channel_of(
        [0, 6],
        [1, 4],
        tangent=Tangent.FREE,
        out_handles=np.array([out, (0, 0)], float),
        in_handles=np.array([(0, 0), into], float),
    )
    at = np.linspace(0, 6, 61)
    points = [(0, 1), (out[0], 1 + out[1]), (6 + into[0], 4 + into[1]), (6, 4)]
    found = evaluate(component_curves([channel]), at)[0]
    np.testing.assert_allclose(found, bezier(points, at), rtol=0, atol=1e-12)
    assert component_curves([channel]).kinds[0] == SegmentKind.BEZIER


@pytest.mark.parametrize(
    ("out", "into", "kind"),
    [
        (2, -2, SegmentKind.CUBIC),
        (1, -2, SegmentKind.BEZIER),
        (2, -1, SegmentKind.BEZIER),
        (3, -3, SegmentKind.BEZIER),
    ],
)
def test_bezier_is_cubic_where_both_handles_are_at_thirds(
    out: float, into: float, kind: SegmentKind
) -> None:
    free = channel_of(
        [0, 6],
        [1, 4],
        tangent=Tangent.FREE,
        out_handles=np.array([[out, 5.0], [0, 0]]),
        in_handles=np.array([[0, 0], [into, 1.0]]),
    )
    assert component_curves([free]).kinds[0] == kind


def test_hermite_slopes_are_those_of_the_handles() -> None:
    slopes = np.array([1.0, -2.0, 0.5, 0.0, 3.0])
    lengths = np.array([0.5, 0.1, 2.0, 1.0, 4.0])
    channel = channel_of(
        TIMES,
        VALUES,
        Interp.HERMITE,
        Tangent.FREE,
        in_handles=np.stack([-lengths, -lengths * slopes], -1),
        out_handles=np.stack([2 * lengths, 2 * lengths * (slopes + 1)], -1),
    )
    assert_slopes(channel, slopes, slopes + 1)


@pytest.mark.parametrize("interp", [Interp.BEZIER, Interp.HERMITE])
def test_tangents_by_rule(interp: Interp) -> None:
    values = np.array(VALUES)[:, None]
    straight = np.diff(VALUES) / np.diff(TIMES)
    zeros = np.zeros(5)
    auto = tangents.parabola_slopes(TIMES, values)
    clamped = tangents.auto_clamped(TIMES, values)
    for tangent, ins, outs in (
        (Tangent.FLAT, zeros, zeros),
        (Tangent.LINEAR, np.r_[0, straight], np.r_[straight, 0]),
        (Tangent.AUTO, auto, auto),
        (Tangent.AUTO_CLAMPED, clamped, clamped),
    ):
        assert_slopes(channel_of(TIMES, VALUES, interp, tangent), ins, outs)


def test_auto_clamped_stays_between_the_keys() -> None:
    channel = channel_of(TIMES, VALUES, tangent=Tangent.AUTO_CLAMPED)
    for k in range(4):
        found = along(channel, k)
        assert found.min() >= min(VALUES[k : k + 2]) - 1e-15
        assert found.max() <= max(VALUES[k : k + 2]) + 1e-15


def test_tcb() -> None:
    values = np.array(VALUES)[:, None]
    auto = tangents.parabola_slopes(TIMES, values)
    assert_slopes(channel_of(TIMES, VALUES, Interp.TCB), auto, auto)
    settings = np.tile([0.5, -0.3, 0.2], (5, 1))
    ins, outs = tangents.tcb(TIMES, values, settings)
    assert_slopes(channel_of(TIMES, VALUES, Interp.TCB, tcb=settings), ins, outs)


def test_uniform_catmull_rom_has_the_secants_slope() -> None:
    slopes = tangents.secant_slopes(TIMES, np.array(VALUES)[:, None])
    assert_slopes(channel_of(TIMES, VALUES, Interp.CATMULL_ROM), slopes, slopes)


def barry_goldman(points: FloatArray, alpha: float) -> FloatArray:
    """Return the Catmull-Rom path between the middle two of four points."""
    lengths = np.linalg.norm(np.diff(points, axis=0), axis=1)
    knots = np.cumsum([0.0, *lengths**alpha])
    t = (knots[1] + U * (knots[2] - knots[1]))[:, None]
    paths = [point + 0 * t for point in points]
    for ends in (((0, 1), (1, 2), (2, 3)), ((0, 2), (1, 3)), ((1, 2),)):
        paths = [
            a + (t - knots[i]) / (knots[j] - knots[i]) * (b - a)
            for (i, j), a, b in zip(ends, paths[:-1], paths[1:], strict=True)
        ]
    return np.asarray(paths[0])


@pytest.mark.parametrize(
    ("parametrization", "alpha"),
    [(Parametrization.CENTRIPETAL, 0.5), (Parametrization.CHORDAL, 1.0)],
)
def test_catmull_rom_traces_the_path(
    parametrization: Parametrization, alpha: float
) -> None:
    points = np.random.default_rng(3).normal(size=(5, 3))
    channel = channel_of(
        TIMES, points, Interp.CATMULL_ROM, parametrization=parametrization
    )
    for k in (1, 2):
        path = barry_goldman(points[k - 1 : k + 3], alpha)
        np.testing.assert_allclose(along(channel, k), path, rtol=0, atol=1e-13)


def test_interps_may_differ_from_key_to_key() -> None:
    kinds = (Interp.LINEAR, Interp.STEP, Interp.TCB, Interp.CATMULL_ROM, Interp.STEP)
    mixed = channel_of(TIMES, VALUES, kinds)
    for k, kind in enumerate(kinds[:-1]):
        alone = channel_of(TIMES, VALUES, kind)
        np.testing.assert_array_equal(along(mixed, k), along(alone, k))


def test_components_come_in_the_order_of_the_channels() -> None:
    one = channel_of([0, 2], [[0, 10], [2, 30]], Interp.LINEAR)
    other = channel_of([1, 2, 3], [5, 6, 7], Interp.LINEAR)
    curves = component_curves([one, other])
    assert curves.first_keys.tolist() == [0, 2, 4, 7]
    np.testing.assert_allclose(evaluate(curves, [1.0])[:, 0], [1, 20, 5])
    assert evaluate(component_curves([]), [1.0]).shape == (0, 1)


def test_a_single_key() -> None:
    for interp in (Interp.BEZIER, Interp.TCB, Interp.CATMULL_ROM):
        found = evaluate(
            component_curves([channel_of([3], [7], interp)]), [0.0, 3.0, 9.0]
        )
        assert found.tolist() == [[7, 7, 7]]
