"""Writing a clip as a clip file, from which it comes back equal."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Hashable, Iterable, Iterator, Sequence
from itertools import chain
from typing import TypeVar

from animtool.clip.channels import (
    ClipChannel,
    ClipUnits,
    Interp,
    Parametrization,
    Tangent,
)
from animtool.clip.clip import Clip
from animtool.documents.names import flow, number, scaled, text
from animtool.maths.curves import Extrapolation
from animtool.rig.skeleton import Rig
from animtool.units import unit_name

Choice = TypeVar("Choice", bound=Hashable)
Tangents = tuple[Tangent, Tangent]
# Of a channel that does not say.
USUAL_TANGENT = Tangent.AUTO_CLAMPED


def clip_text(clip: Clip, rig: Rig, rig_file: str) -> str:
    """Return a clip as the text of a clip file, in the units of its rig.

    Numbers that the rig's unit cannot give back to the last digit are written in
    metres or radians instead; the file says which.

    Args:
        clip: Quaternions of its keys at unit length, of signs that continue, and
            handles where tangents are free, as `animtool.clip.file.load_clip` has it.
        rig: Whose units it is written in.
        rig_file: The rig file, as the clip is to name it.
    """
    units = _units(clip, rig)
    angle = "rad" if units.angle == 1.0 else "deg"
    lines = [
        "clip: animtool/1",
        f"name: {text(clip.name)}",
        f"rig: {text(rig_file)}",
        f"units: {{length: {unit_name(units.length)}, angle: {angle}}}",
        f"fps: {text(str(clip.fps)) if clip.fps.denominator > 1 else clip.fps}",
        f"range: {flow([number(float(clip.first)), number(float(clip.last))])}",
        "channels:" if clip.channels else "channels: []",
    ]
    for channel in clip.channels:
        unit = units.of(channel.target, channel.euler)
        lines.append(f"- target: {text(channel.target)}")
        lines += [f"  {line}" for line in curve_lines(channel, unit)]
    return "\n".join(lines) + "\n"


def _units(clip: Clip, rig: Rig) -> ClipUnits:
    """Return the units that a clip is written in."""
    usual = ClipUnits.of_rig(rig)
    lengths = _numbers_in(clip, ClipUnits(math.nan, 1.0))
    angles = _numbers_in(clip, ClipUnits(1.0, math.nan))
    return ClipUnits(
        usual.length if _come_back(lengths, usual.length) else 1.0,
        usual.angle if _come_back(angles, usual.angle) else 1.0,
    )


def _numbers_in(clip: Clip, marked: ClipUnits) -> Iterator[float]:
    """Yield the values and handles of the channels whose unit is marked, by NaN."""
    for channel in clip.channels:
        if math.isnan(marked.of(channel.target, channel.euler)):
            yield from channel.values.ravel().tolist()
            yield from channel.ins[:, 1:].ravel().tolist()
            yield from channel.outs[:, 1:].ravel().tolist()


def _come_back(values: Iterable[float], unit: float) -> bool:
    return all(float(scaled(value, unit)) * unit == value for value in values)


def curve_lines(channel: ClipChannel, unit: float) -> Iterator[str]:
    """Yield the lines of a curve of keys, its target left out.

    Args:
        channel: The curve.
        unit: What a value of 1 means: [m], [rad] or [1].
    """
    interp = _commonest(channel.interps, Interp.LINEAR)
    ruled = [t for t in chain(*channel.tangents) if t is not Tangent.FREE]
    tangent = _commonest(ruled, USUAL_TANGENT)
    yield f"interp: {interp}"
    for key, value, usual in (
        ("tangents", tangent, USUAL_TANGENT),
        ("parametrization", channel.parametrization, Parametrization.UNIFORM),
        ("euler", channel.euler, ""),
        ("pre", channel.pre, Extrapolation.HOLD),
        ("post", channel.post, Extrapolation.HOLD),
    ):
        if value != usual:
            yield f"{key}: {value}"
    yield "keys:"
    for k in range(len(channel.times)):
        shown = ", ".join(_key(channel, k, interp, tangent, unit))
        yield f"- {{{shown}}}"


def _key(
    channel: ClipChannel, k: int, interp: Interp, tangent: Tangent, unit: float
) -> Iterator[str]:
    """Yield the entries of a key; what the channel says already is left out."""
    row = channel.values[k].tolist()
    if row[3:]:
        x, y, z, w = row
        row = [w, x, y, z]
    yield f"t: {number(float(channel.times[k]))}"
    yield f"v: {_value(row, unit)}"
    if channel.interps[k] is not interp:
        yield f"interp: {channel.interps[k]}"
    handles = (channel.ins[k].tolist(), channel.outs[k].tolist())
    for name, own, (dt, *dv) in zip(
        ("in", "out"), channel.tangents[k], handles, strict=True
    ):
        if own is Tangent.FREE:
            yield f"{name}: {flow([number(dt), _value(dv, unit)])}"
        elif own is not tangent:
            yield f"{name}: {own}"
    if channel.tcb[k].any():
        yield f"tcb: {flow([number(value) for value in channel.tcb[k].tolist()])}"


def _value(row: Sequence[float], unit: float) -> str:
    shown = [scaled(value, unit) for value in row]
    return shown[0] if len(shown) == 1 else flow(shown)


def _commonest(choices: Sequence[Choice], usual: Choice) -> Choice:
    """Return what most of them are, the first of several; without any, the usual."""
    return Counter(choices).most_common(1)[0][0] if choices else usual
