"""Writing a reduced take as a clip file."""

from __future__ import annotations

import numpy as np

from animtool._types import FloatArray
from animtool.clip.reduction import ChannelKind, ReducedChannel, Reduction
from animtool.documents.numbers import flow, number, text
from animtool.rig.skeleton import Rig
from animtool.units import unit_name

__all__ = ["clip_text"]

# Significant digits: beside the tolerance of any reduction, rounding is nothing.
DIGITS = 10


def clip_text(reduction: Reduction, rig: Rig, rig_file: str, name: str) -> str:
    """Return a reduction as the text of a clip file, in the rig's units.

    Keys are Hermite ones, their tangents slopes a frame: each segment is the cubic
    that was fitted. Rotations are Euler angles in degrees, relative to the joint's
    rest where the joint turns freely, else in its parent's space.

    Args:
        reduction: Keys in metres and degrees, frames from 0.
        rig: Whose joints its channels name.
        rig_file: The rig file, as the clip is to name it.
        name: What the clip is called.
    """
    clock = reduction.clock
    step = float(clock.step)
    start = float(clock.start)
    last = start + (clock.count - 1) * step
    lines = [
        "clip: animtool/1",
        f"name: {text(name)}",
        f"rig: {text(rig_file)}",
        "units: {angle: deg}",
        f"fps: {text(str(clock.fps)) if clock.fps.denominator > 1 else clock.fps}",
        f"range: {flow([number(start), number(last)])}",
        "channels:",
    ]
    for channel in reduction.channels:
        lines.append(f"- target: {text(_target(channel, rig))}")
        lines.append("  interp: hermite")
        if channel.order is not None:
            lines.append(f"  euler: {channel.order}")
        lines.append("  keys:")
        lines += _keys(channel, rig, start, step)
    return "\n".join(lines) + "\n"


def _target(channel: ReducedChannel, rig: Rig) -> str:
    if channel.kind is ChannelKind.WEIGHT:
        return f"shape/{rig.shapes[channel.index].name}"
    part = {
        ChannelKind.TRANSLATION: "local_translation",
        ChannelKind.ROTATION: "local_rotation",
        ChannelKind.SCALE: "scale",
    }[channel.kind]
    return f"joint/{channel.joint}.{part}"


def _keys(channel: ReducedChannel, rig: Rig, start: float, step: float) -> list[str]:
    keys = channel.keys
    unit = 1.0
    if channel.kind is ChannelKind.TRANSLATION:
        named = " " not in unit_name(rig.meters_per_unit)
        unit = rig.meters_per_unit if named else 1.0
    times = start + keys.frames * step
    spans = np.diff(times)
    lines = []
    for k, time in enumerate(times.tolist()):
        entry = f"  - {{t: {number(time)}, v: {_value(keys.values[k] / unit)}"
        if k > 0:
            slope = -3 * keys.ins[k] / spans[k - 1] / unit
            entry += f", in: [-1, {_value(-slope)}]"
        if k < len(spans):
            slope = 3 * keys.outs[k] / spans[k] / unit
            entry += f", out: [1, {_value(slope)}]"
        lines.append(entry + "}")
    return lines


def _value(values: FloatArray) -> str:
    shown = [number(float(f"{value + 0.0:.{DIGITS}g}")) for value in values.tolist()]
    return shown[0] if len(shown) == 1 else flow(shown)
