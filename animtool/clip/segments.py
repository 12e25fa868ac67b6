"""The keys of clip channels as curves that can be evaluated."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from animtool._types import FloatArray, IntArray
from animtool.clip.channels import ClipChannel, Interp, Parametrization, Tangent
from animtool.maths import tangents as rules
from animtool.maths.curves import Curves, SegmentKind
from animtool.maths.rotation_curves import RotationKind

_Rule = Callable[[FloatArray, FloatArray], FloatArray]

_ALPHA = {
    Parametrization.UNIFORM: 0.0,
    Parametrization.CENTRIPETAL: 0.5,
    Parametrization.CHORDAL: 1.0,
}
_KINDS = {Interp.STEP: SegmentKind.HOLD, Interp.LINEAR: SegmentKind.LINEAR}
_ROTATION_KINDS = {
    Interp.STEP: RotationKind.STEP,
    Interp.SLERP: RotationKind.SLERP,
    Interp.SQUAD: RotationKind.SQUAD,
    Interp.SPLINE: RotationKind.SPLINE,
}


def rotation_kinds(channel: ClipChannel) -> IntArray:
    """Return how a quaternion channel runs behind each key ``(K,)``."""
    return np.array([_ROTATION_KINDS[interp] for interp in channel.interps], np.int64)


def curves_of(channels: Sequence[ClipChannel]) -> Curves:
    """Return the components of channels as curves, in order: C = ΣD.

    Handles by a rule lie at thirds of their segments, so that time runs evenly; free
    ones stay where they are. Catmull-Rom takes, uniform, the secant through the
    neighbours over time, which keeps the velocity continuous for keys at any times;
    centripetal and chordal trace the path of Barry and Goldman's pyramid.
    """
    parts = [_channel_curves(channel) for channel in channels]
    first = [0]
    for channel in channels:
        keys = len(channel.times)
        first += [first[-1] + keys * (i + 1) for i in range(channel.values.shape[1])]
    return Curves(
        np.array(first, np.int64),
        _joined([times for times, *_ in parts]),
        _joined([values for _, values, *_ in parts]),
        np.concatenate([np.zeros(0, np.int64), *[kinds for _, _, kinds, *_ in parts]]),
        np.concatenate([np.zeros((0, 2)), *[ins for *_, ins, _ in parts]]),
        np.concatenate([np.zeros((0, 2)), *[outs for *_, outs in parts]]),
        tuple(c.pre for c in channels for _ in range(c.values.shape[1])),
        tuple(c.post for c in channels for _ in range(c.values.shape[1])),
    )


def _joined(parts: list[FloatArray]) -> FloatArray:
    return np.concatenate([np.zeros(0), *parts])


def _channel_curves(
    channel: ClipChannel,
) -> tuple[FloatArray, FloatArray, IntArray, FloatArray, FloatArray]:
    """Return times, values, kinds, handles of a channel, component by component."""
    keys, width = channel.values.shape
    ins, outs, kinds = _handles(channel)
    return (
        np.tile(channel.times, width),
        channel.values.T.ravel(),
        np.tile(kinds, width),
        np.stack([np.repeat(ins[None, :, 0], width, 0), ins[:, 1:].T], -1).reshape(
            keys * width, 2
        ),
        np.stack([np.repeat(outs[None, :, 0], width, 0), outs[:, 1:].T], -1).reshape(
            keys * width, 2
        ),
    )


def _handles(channel: ClipChannel) -> tuple[FloatArray, FloatArray, IntArray]:
    """Return handles ``(K, 1 + D)`` before and behind the keys, and segment kinds."""
    keys, width = channel.values.shape
    ins, outs = np.zeros((keys, 1 + width)), np.zeros((keys, 1 + width))
    kinds = np.full(keys, int(SegmentKind.HOLD), np.int64)
    if keys == 1:
        return ins, outs, kinds
    lengths = np.diff(channel.times)
    slopes = _Slopes(channel)
    for k, interp in enumerate(channel.interps[:-1]):
        third = lengths[k] / 3
        if interp in _KINDS:
            kinds[k] = _KINDS[interp]
            continue
        kinds[k] = SegmentKind.CUBIC
        outs[k], ins[k + 1, 0] = third, -third
        if interp is Interp.CATMULL_ROM:
            outs[k, 1:], ins[k + 1, 1:] = slopes.catmull_rom(k, third)
            continue
        for key, side in ((k, 1), (k + 1, 0)):
            handles = outs if side else ins
            given = (channel.outs if side else channel.ins)[key]
            tangent = channel.tangents[key][side]
            signed = third if side else -third
            if interp is Interp.TCB:
                handles[key, 1:] = slopes.tcb[side][key] * signed
            elif tangent is not Tangent.FREE:
                slope = slopes.by_rule(tangent, key, k)
                handles[key] = [signed, *(slope * signed)]
            elif interp is Interp.HERMITE:
                slope = given[1:] / given[0] if given[0] else np.zeros(width)
                handles[key] = [signed, *(slope * signed)]
            else:
                handles[key] = given
                if given[0] != signed:
                    kinds[k] = SegmentKind.BEZIER
    return ins, outs, kinds


class _Slopes:
    """Slopes of a channel at its keys, by the rules that it uses."""

    def __init__(self, channel: ClipChannel) -> None:
        self.channel = channel
        self._made: dict[str, FloatArray] = {}
        self._paths: tuple[FloatArray, FloatArray] | None = None
        self._tcb: tuple[FloatArray, FloatArray] | None = None

    @property
    def tcb(self) -> tuple[FloatArray, FloatArray]:
        """Slopes before and behind each key ``(K, D)``."""
        if self._tcb is None:
            c = self.channel
            self._tcb = rules.tcb(c.times, c.values, c.tcb)
        return self._tcb

    def by_rule(self, tangent: Tangent, key: int, segment: int) -> FloatArray:
        """Return the slope at a key, of a segment that it ends ``(D,)``."""
        c = self.channel
        if tangent is Tangent.FLAT:
            return np.zeros(c.values.shape[1])
        if tangent is Tangent.LINEAR:
            rise = c.values[segment + 1] - c.values[segment]
            return np.asarray(rise / (c.times[segment + 1] - c.times[segment]))
        rule = {
            Tangent.AUTO: rules.nonuniform,
            Tangent.AUTO_CLAMPED: rules.auto_clamped,
        }[tangent]
        return np.asarray(self._slopes(rule.__name__, rule)[key])

    def catmull_rom(self, k: int, third: float) -> tuple[FloatArray, FloatArray]:
        """Return the handles' values of a segment, behind and before its keys."""
        c = self.channel
        if c.parametrization is Parametrization.UNIFORM:
            slopes = self._slopes("secant", rules.secant)
            return slopes[k] * third, -slopes[k + 1] * third
        if self._paths is None:
            alpha = _ALPHA[c.parametrization]
            self._paths = rules.catmull_rom_controls(c.values, alpha)
        ins, outs = self._paths
        return outs[k], ins[k + 1]

    def _slopes(self, name: str, rule: _Rule) -> FloatArray:
        if name not in self._made:
            self._made[name] = rule(self.channel.times, self.channel.values)
        return self._made[name]
