"""Writes target tracks as a targets file."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import field

import numpy as np

from animtool.clip.channels import ClipUnits
from animtool.clip.clip import curve_lines
from animtool.core.array_types import FloatArray
from animtool.core.names import decimal_text, flow_list, scaled_decimal, yaml_scalar
from animtool.core.record import dataclass
from animtool.core.units import unit_name
from animtool.ik.goals import GOAL_PARTS, Goal
from animtool.ik.schema import GoalModel
from animtool.ik.tracks import GoalTrack, TargetTracks
from animtool.ik.values import ArrayRows, ConstantValue, KeyedValue, SampledValue

DEFAULT_EASE = float(GoalModel.model_fields["ease"].default)


@dataclass(frozen=True, slots=True)
class TargetsText:
    """The text of a targets file, and the arrays it refers to."""

    text: str  # text of the targets file
    # By their references, ``file.npz#name``, in the units of the file and quaternions w
    # x y z.
    arrays: dict[str, FloatArray] = field(repr=False)


def targets_text(tracks: TargetTracks, units: ClipUnits) -> TargetsText:
    """Return tracks as the text of a targets file, and their arrays.

    Numbers are read back exactly, apart from the last digit after a unit conversion.

    Args:
        tracks: Target tracks of constants, keys and arrays named with their files.
        units: Units of the file.
    """
    writer = _TargetsWriter(units)
    return TargetsText("\n".join(writer.file_lines(tracks)) + "\n", writer.arrays)


@dataclass(frozen=True, slots=True)
class _TargetsWriter:
    """Formats target tracks, and collects the arrays they refer to."""

    units: ClipUnits
    arrays: dict[str, FloatArray] = field(default_factory=dict)

    def file_lines(self, tracks: TargetTracks) -> Iterator[str]:
        """Yield the YAML lines of a targets file, and collect its arrays."""
        angle = "rad" if self.units.angle == 1.0 else "deg"
        yield "targets: animtool/1"
        yield f"units: {{length: {unit_name(self.units.length)}, angle: {angle}}}"
        fps = tracks.fps
        if fps is not None:
            yield f"fps: {yaml_scalar(str(fps)) if fps.denominator > 1 else fps}"
        if tracks.first is not None and tracks.last is not None:
            yield f"range: {_flow_text([float(tracks.first), float(tracks.last)])}"
        yield "goals:"
        for track in tracks.goals:
            yield f"- effector: {yaml_scalar(track.name)}"
            yield from _indented(self._goal_lines(track))

    def _goal_lines(self, track: GoalTrack) -> Iterator[str]:
        """Yield the YAML lines of a goal that follow its effector."""
        goal, chain = track.goal, track.chain
        if goal.root is not None and (chain is None or goal.root != chain.root):
            yield f"root: {yaml_scalar(goal.root)}"
        if any(goal.offset):
            yield f"offset: {_flow_text(goal.offset, self.units.length)}"
        for part in GOAL_PARTS:
            value = track.values[part]
            if value is None:
                continue
            if part == "aim":
                yield "aim:"
                yield f"  axis: {_flow_text(goal.aim_axis)}"
                yield from _indented(self._value_lines("at", value))
            else:
                yield from self._value_lines(part, value)
        yield from self._weight_lines(track)
        yield from _option_lines(track, goal)

    def _value_lines(self, key: str, value: SampledValue) -> Iterator[str]:
        """Yield the lines of a value: a constant, an array or keys."""
        unit = 1.0 if key in {"orientation", "weight"} else self.units.length
        match value:
            case ConstantValue(row):
                numbers = _to_file_order(np.array([row]))[0].tolist()
                yield f"{key}: {_flow_text(numbers, unit)}"
            case ArrayRows(name, rows):
                self.arrays[name] = _to_file_order(rows) / unit
                yield f"{key}: {yaml_scalar(name)}"
            case KeyedValue(channel):
                yield f"{key}:"
                unit = self.units.angle if channel.euler else unit
                yield from _indented(curve_lines(channel, unit))
            case _:
                raise ValueError(f"{key} follows a prim, which is not written")

    def _weight_lines(self, track: GoalTrack) -> Iterator[str]:
        """Yield the weights that differ from 1."""
        weights = track.weights
        if not weights:
            return
        first = weights.get(GOAL_PARTS[0])
        if isinstance(first, ConstantValue) and weights == dict.fromkeys(
            GOAL_PARTS, first
        ):
            yield f"weight: {decimal_text(first.value[0])}"
            return
        yield "weight:"
        for part, weight in weights.items():
            if isinstance(weight, ConstantValue):
                yield f"  {part}: {decimal_text(weight.value[0])}"
            elif isinstance(weight, KeyedValue):
                yield f"  {part}:"
                yield from _indented(_indented(curve_lines(weight.channel, 1.0)))


def _option_lines(track: GoalTrack, goal: Goal) -> Iterator[str]:
    """Yield the lines of a goal's options that differ from their defaults."""
    stretch = 0.0 if track.chain is None else track.chain.stretch
    for key, value, default in (
        ("priority", goal.priority, 0),
        ("soft", goal.soft, 0.0),
        ("stretch", goal.stretch, stretch),
    ):
        if value != default:
            yield f"{key}: {decimal_text(value)}"
    for key, spans in (("hold", track.spans), ("during", track.during)):
        if spans:
            yield f"{key}: {flow_list([_flow_text(span) for span in spans])}"
    if track.ease != DEFAULT_EASE:
        yield f"ease: {decimal_text(track.ease)}"


def _indented(lines: Iterable[str]) -> Iterator[str]:
    """Yield lines indented by two spaces."""
    return (f"  {line}" for line in lines)


def _to_file_order(values: FloatArray) -> FloatArray:
    """Reorder quaternions ``(R, 4)`` to w x y z; points ``(R, 3)`` stay unchanged."""
    return values[:, [3, 0, 1, 2]] if values.shape[1] == 4 else values


def _flow_text(values: Sequence[float], unit: float = 1.0) -> str:
    """Return numbers as the text of a YAML list, divided by a unit."""
    return flow_list([scaled_decimal(value, unit) for value in values])
