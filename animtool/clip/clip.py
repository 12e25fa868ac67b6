"""Clips in memory, and their text form."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from dataclasses import field
from fractions import Fraction
from itertools import chain
from pathlib import Path
from typing import TypeVar, cast

from animtool.clip.channels import ClipChannel, ClipUnits, check_targets
from animtool.core.array_types import FloatArray
from animtool.core.clock import MAX_FRAME_COUNT, Clock, time_codes
from animtool.core.errors import Fault, FormatError, counted, refuse
from animtool.core.loaded import check_loaded
from animtool.core.names import decimal_text, flow_list, scaled_decimal, yaml_scalar
from animtool.core.plugins import load_object
from animtool.core.rates import FractionLike, rate_label, rate_option
from animtool.core.record import dataclass
from animtool.core.units import unit_name
from animtool.maths.curves import Extrapolation, Interp
from animtool.maths.tangents import Parametrization, Tangent
from animtool.motion.motion import Motion
from animtool.motion.take import Take
from animtool.rig.skeleton import Rig

# Default tangent rule of a channel.
DEFAULT_TANGENT = Tangent.AUTO_CLAMPED


@dataclass(frozen=True, slots=True)
class Clip:
    """A keyframe clip for a rig.

    Attributes:
        name: Name of the clip.
        fps: Frame rate of the key times [1/s].
        first: First frame of the range.
        last: Last frame of the range, not before the first.
        channels: Channels, one per target.
        notices: Warnings about the file that it was read from; not compared.
        rig_path: The rig file that its file names; not compared.
    """

    name: str
    fps: Fraction
    first: Fraction
    last: Fraction
    channels: tuple[ClipChannel, ...]
    notices: tuple[Fault, ...] = field(default=(), repr=False, compare=False)
    rig_path: Path | None = field(default=None, repr=False, compare=False)

    @classmethod
    def load(cls, path: Path | str, rig: Rig | Path | str | None = None) -> Clip:
        """Load a clip file and check its targets and units against a rig.

        Args:
            path: The file.
            rig: The clip's rig or rig file; None uses the rig named by the clip.

        Raises:
            FormatError: The clip or its rig is malformed; lists every fault.
            OptionError: The clip names no rig (CLIP011).
        """
        load = load_object("animtool.clip.file:load_clip_of")
        return cast("Clip", cast("Callable[..., object]", load)(path, rig))

    def frame_count(
        self, fps: FractionLike | None = None, step: Fraction = Fraction(1)
    ) -> int:
        """Return the number of frames in the range.

        Args:
            fps: Frame rate; None uses the clip's.
            step: Time codes per frame.

        Raises:
            FormatError: No frame, or more than 10 million (CLIP006).
            OptionError: The rate is invalid (SCN022).

        >>> Clip("nod", Fraction(24), Fraction(1), Fraction(13), ()).frame_count()
        13
        """
        codes_per_frame = step * self.fps / _rate_or_default(fps, self.fps)
        frame_count = (self.last - self.first) // codes_per_frame + 1
        if not 0 < frame_count <= MAX_FRAME_COUNT:
            message = (
                f"the range has {frame_count} frames; the limit is {MAX_FRAME_COUNT}"
            )
            if frame_count <= 0:
                message = "the range contains no frame"
            raise FormatError(Fault("CLIP006", message, where="range"))
        return frame_count

    def sample(
        self,
        rig: Rig,
        fps: FractionLike | None = None,
        *,
        step: Fraction | float = 1,
        clamp: bool = False,
    ) -> Take:
        """Sample the clip on a rig over its range.

        Controls out of range and joints beyond their limits are listed in the
        take's notices.

        Args:
            rig: The rig of its targets.
            fps: Frames per second, such as 24, ``"23.976"`` or ``Fraction(24000,
                1001)``; None uses the clip's.
            step: Time codes per frame, such as 0.25 for four samples per frame.
            clamp: Clamp controls to their ranges and joints to their limits.

        Raises:
            OptionError: A target is not in the rig (CLIP001 to CLIP003), or
                the rate (SCN022) or the step (CLIP021) is invalid.
            FormatError: The range has no frame, or over 10 million (CLIP006);
                an expression of the rig is undefined at a frame (CLIP015).

        >>> from animtool.rig.skeleton import Joint
        >>> hero = Rig("hero", (Joint("hips", -1),))
        >>> nod = Clip("nod", Fraction(24), Fraction(1), Fraction(13), ())
        >>> nod.sample(hero, fps=48)
        <Take of 'hero': 25 frames from 1 to 25 at 48 fps, 1 joint>
        """
        from animtool.clip.keyed_curve import KeyedCurve
        from animtool.clip.sample import sample_channels

        check_loaded(rig, Rig, "rig")
        rate, codes_per_frame = _rate_or_default(fps, self.fps), _exact_step(step)
        targets = [channel.target for channel in self.channels]
        check_targets(targets, rig, self.rig_path)
        frame_count = self.frame_count(rate, codes_per_frame)
        times = time_codes(self.first, codes_per_frame * self.fps / rate, frame_count)
        sampled_motion = sample_channels(self.channels, rig, times, clamp=clamp)
        first_code, frames_per_code = float(self.first), float(self.fps / rate)

        def curve(codes: FloatArray) -> Motion:
            """Return the motion of the clip at time codes of the take."""
            clip_times = first_code + (codes - first_code) * frames_per_code
            return sample_channels(self.channels, rig, clip_times, clamp=clamp).motion

        clock = Clock(rate, self.first, codes_per_frame, frame_count)
        notices = tuple(sampled_motion.notices)
        is_exact = not clamp and rate == self.fps
        keyed_curve = KeyedCurve(curve, lambda: self if is_exact else None)
        return Take(rig, clock, sampled_motion.motion, notices, curve=keyed_curve)

    def __repr__(self) -> str:
        """Return the name, the numbers of channels and keys, and the frame range."""
        keys = counted(sum(len(channel.times) for channel in self.channels), "key")
        channels = counted(len(self.channels), "channel")
        return (
            f"<Clip {self.name!r}: {channels}, {keys}, frames {float(self.first):g} to "
            f"{float(self.last):g} at {rate_label(self.fps)}>"
        )


def _rate_or_default(fps: FractionLike | None, default: Fraction) -> Fraction:
    """Return a frame rate as a fraction; the default if it is None."""
    return default if fps is None else rate_option(fps)


def _exact_step(step: Fraction | float) -> Fraction:
    """Return a step as a fraction; raise unless it is positive and finite."""
    try:
        # The decimal as written, not the nearest float.
        codes_per_frame = Fraction(str(step))
    except ValueError:
        codes_per_frame = Fraction(0)
    if codes_per_frame <= 0:
        refuse("CLIP021", f"step is {step}; it must be a positive number")
    return codes_per_frame


ChoiceT = TypeVar("ChoiceT", bound=Hashable)


def clip_text(clip: Clip, rig: Rig, rig_file: str) -> str:
    """Format a clip as the text of a clip file, in the units of its rig.

    Numbers that do not round-trip exactly in the rig's unit are written in metres or
    radians instead; the file says which. Quaternions of the clip's keys have unit
    length and continuous signs, and free tangents have handles, as after
    `animtool.clip.file.load_clip`. ``rig_file`` is the rig file as named in the clip.
    """
    units = _units_to_write(clip, rig)
    range_texts = [decimal_text(float(end)) for end in (clip.first, clip.last)]
    text_lines = [
        "clip: animtool/1",
        f"name: {yaml_scalar(clip.name)}",
        f"rig: {yaml_scalar(rig_file)}",
        f"units: {{length: {unit_name(units.length)}, angle: {units.angle_name}}}",
        f"fps: {yaml_scalar(str(clip.fps)) if clip.fps.denominator > 1 else clip.fps}",
        f"range: {flow_list(range_texts)}",
        "channels:" if clip.channels else "channels: []",
    ]
    for channel in clip.channels:
        unit = units.unit_of(channel.target, channel.euler)
        text_lines.append(f"- target: {yaml_scalar(channel.target)}")
        text_lines += [f"  {line}" for line in curve_lines(channel, unit)]
    return "\n".join(text_lines) + "\n"


def _units_to_write(clip: Clip, rig: Rig) -> ClipUnits:
    """Return the units of the written file: the rig's if numbers round-trip in them."""
    rig_units = ClipUnits.of_rig(rig)
    lengths = _numbers_in(clip, ClipUnits(math.nan, 1.0))
    angles = _numbers_in(clip, ClipUnits(1.0, math.nan))
    return ClipUnits(
        rig_units.length if _round_trips(lengths, rig_units.length) else 1.0,
        rig_units.angle if _round_trips(angles, rig_units.angle) else 1.0,
    )


def _numbers_in(clip: Clip, units_with_nan: ClipUnits) -> Iterator[float]:
    """Yield the values and handles of the channels whose unit is NaN."""
    for channel in clip.channels:
        if math.isnan(units_with_nan.unit_of(channel.target, channel.euler)):
            yield from channel.values.ravel().tolist()
            yield from channel.in_handles[:, 1:].ravel().tolist()
            yield from channel.out_handles[:, 1:].ravel().tolist()


def _round_trips(values: Iterable[float], unit: float) -> bool:
    """Return whether all values round-trip exactly when written in a unit."""
    return all(float(scaled_decimal(value, unit)) * unit == value for value in values)


def curve_lines(channel: ClipChannel, unit: float) -> Iterator[str]:
    """Yield the lines of a key curve, without its target.

    Values are written in ``unit``: [m], [rad] or [1].
    """
    interp = _most_common(channel.interps, Interp.LINEAR)
    tangent_rules = [t for t in chain(*channel.tangents) if t is not Tangent.FREE]
    tangent = _most_common(tangent_rules, DEFAULT_TANGENT)
    yield f"interp: {interp}"
    for key, value, default in (
        ("tangents", tangent, DEFAULT_TANGENT),
        ("parametrization", channel.parametrization, Parametrization.UNIFORM),
        ("euler", channel.euler, ""),
        ("pre", channel.pre, Extrapolation.HOLD),
        ("post", channel.post, Extrapolation.HOLD),
    ):
        if value != default:
            yield f"{key}: {value}"
    yield "keys:"
    for k in range(len(channel.times)):
        entries = ", ".join(_key_entries(channel, k, interp, tangent, unit))
        yield f"- {{{entries}}}"


def _key_entries(
    channel: ClipChannel, key_index: int, interp: Interp, tangent: Tangent, unit: float
) -> Iterator[str]:
    """Yield the entries of a key that differ from the channel's."""
    numbers = channel.values[key_index].tolist()
    if numbers[3:]:
        x, y, z, w = numbers
        numbers = [w, x, y, z]
    yield f"t: {decimal_text(float(channel.times[key_index]))}"
    yield f"v: {_value_text(numbers, unit)}"
    if channel.interps[key_index] is not interp:
        yield f"interp: {channel.interps[key_index]}"
    handles = (
        channel.in_handles[key_index].tolist(),
        channel.out_handles[key_index].tolist(),
    )
    for name, handle_tangent, (dt, *dv) in zip(
        ("in", "out"), channel.tangents[key_index], handles, strict=True
    ):
        if handle_tangent is Tangent.FREE:
            yield f"{name}: {flow_list([decimal_text(dt), _value_text(dv, unit)])}"
        elif handle_tangent is not tangent:
            yield f"{name}: {handle_tangent}"
    if channel.tcb[key_index].any():
        tcb = [decimal_text(value) for value in channel.tcb[key_index].tolist()]
        yield f"tcb: {flow_list(tcb)}"


def _value_text(row: Sequence[float], unit: float) -> str:
    """Format a value as a number or YAML list, divided by a unit."""
    numbers = [scaled_decimal(value, unit) for value in row]
    return numbers[0] if len(numbers) == 1 else flow_list(numbers)


def _most_common(choices: Sequence[ChoiceT], default: ChoiceT) -> ChoiceT:
    """Return the most common of the choices; the default if there are no choices."""
    return Counter(choices).most_common(1)[0][0] if choices else default
