"""Cleans captured takes: removes spikes, and filters each joint by its noise.

A spike is one or a few frames that disagree, all to the same side, with the frames
before, the frames after and the line between them. A step or a corner, such as a foot
landing, agrees with one of the three and stays.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import field, replace

import numpy as np

from animtool.capture.options import CleanOptions
from animtool.core.arguments import argument
from animtool.core.array_types import BoolArray, FloatArray
from animtool.core.errors import Fault, Severity, counted, listed, refuse, warning
from animtool.core.quantities import angle_text, length_text
from animtool.core.record import dataclass
from animtool.maths import so3
from animtool.maths.filters import (
    NOISE_ORDER,
    find_best_cutoff,
    lowpass,
    lowpass_rotations,
    noise_level,
    rotation_noise,
)
from animtool.motion.motion import Channel
from animtool.motion.passes import FrameScope, OptionChecks, Pass, PassContext, TakePart
from animtool.motion.scores import PassScores, Score, ScoreUnit
from animtool.motion.take import Take
from animtool.rig.kinematics import rest_size

# Minimum size of a spike, relative to the typical change of speed around it.
SPIKE_FACTOR = 5.0
# Frames on either side for estimating roughness.
ROUGHNESS_FRAMES = 8
# Minimum size of a spike: a fraction of the rig's size, and a quaternion component.
MIN_SPIKE_SHIFT, MIN_SPIKE_ROTATION = 1e-3, 5e-3
# Noise below this fraction of the smallest spike is rounding of the file.
NEGLIGIBLE_NOISE = 2e-4
# One spike can hide its neighbour until it is removed, so the search is repeated.
MAX_SPIKE_SEARCHES = 3
# Interpolation across a spike keeps frequencies below this fraction of the rate.
BRIDGE_CUTOFF = 0.2
# Noise of good captures is below this [rad].
TYPICAL_NOISE = math.radians(0.2)
# A cut-off that removes more of the power of the motion than this is too low.
MAX_REMOVED = 0.5
# A change of more than this many times the noise is motion.
NOISE_FACTOR = 5.0
MAX_LISTED_JOINTS = 6


@dataclass(frozen=True, slots=True)
class CleanedSignal:
    """Spikes, noise and cut-off frequency of a joint's translations or rotations."""

    joint: str
    rotation: bool  # whether the signal is rotations, not translations
    spikes: tuple[int, ...]  # frames that were replaced, ascending
    noise: float  # standard deviation before filtering [m] or [rad]
    cutoff: float | None  # cut-off frequency [Hz]; None if not filtered
    motion: float = 0.0  # root mean square deviation from the mean [m] or [rad]
    change: float = 0.0  # root mean square change by the filter [m] or [rad]
    max_change: float = 0.0  # largest change by the filter [m] or [rad]

    @property
    def name(self) -> str:
        """Name of the joint and its channel, such as ``hips rotation``."""
        return f"{self.joint} {'rotation' if self.rotation else 'translation'}"

    def text(self, value: float) -> str:
        """Return the text of a value in the signal's unit: an angle or a length."""
        if self.rotation:
            return angle_text(math.degrees(value))
        return length_text(value)


@dataclass(slots=True)
class _JointCleaner:
    """Cleans the channels of a take, joint by joint."""

    names: tuple[str, ...]
    rate: float
    options: CleanOptions
    signals: list[CleanedSignal] = field(default_factory=list)

    def clean_channel(self, channel: Channel, min_size: float) -> Channel:
        """Return a channel with spikes removed and each joint low-pass filtered."""
        is_rotation = channel.rest.shape[1] == 4
        values = channel.values.copy()
        for i, joint in enumerate(channel.animated.tolist()):
            signal = values[:, i]
            spikes = self.options.spikes
            is_spike = _spike_frames(signal, spikes, min_size, rotation=is_rotation)
            if is_spike.any():
                signal = bridge_gaps(signal, ~is_spike, rotation=is_rotation)
            noise = (rotation_noise if is_rotation else noise_level)(signal)
            # A quaternion contains half the angle.
            tolerance = noise / 2 if is_rotation else noise
            is_noisy = tolerance > NEGLIGIBLE_NOISE * min_size
            cutoff = (
                self._choose_cutoff(signal, rotation=is_rotation) if is_noisy else None
            )
            frames = tuple(np.flatnonzero(is_spike).tolist())
            cleaned_signal = CleanedSignal(
                self.names[joint], is_rotation, frames, noise, cutoff
            )
            if cutoff is not None:
                lowpass_filter = lowpass_rotations if is_rotation else lowpass
                filtered_signal = lowpass_filter(signal, cutoff, self.rate)
                if self.options.cutoff is not None:
                    mean = signal.mean(axis=0)
                    if cleaned_signal.rotation:
                        deviation = so3.angle_between(signal, so3.normalize(mean))
                        change = so3.angle_between(signal, filtered_signal)
                    else:
                        deviation = np.linalg.norm(signal - mean, axis=-1)
                        change = np.linalg.norm(signal - filtered_signal, axis=-1)
                    cleaned_signal = replace(
                        cleaned_signal,
                        motion=float(np.sqrt(np.mean(deviation**2))),
                        change=float(np.sqrt(np.mean(change**2))),
                        max_change=float(change.max()),
                    )
                signal = filtered_signal
            values[:, i] = signal
            self.signals.append(cleaned_signal)
        return replace(channel, values=values).compact()

    def _choose_cutoff(self, signal: FloatArray, *, rotation: bool) -> float | None:
        """Return the cut-off frequency of a signal [Hz]; None leaves it unfiltered."""
        if self.options.keep_noise or is_above_nyquist(self.options, self.rate):
            return None
        if self.options.cutoff is not None:
            return self.options.cutoff
        return find_best_cutoff(signal, self.rate, is_rotation=rotation)


def is_above_nyquist(options: CleanOptions, rate: float) -> bool:
    """Return whether a cut-off is at or above half the frame rate."""
    return options.cutoff is not None and options.cutoff >= rate / 2


def bridge_gaps(
    signal: FloatArray, is_known: BoolArray, *, rotation: bool
) -> FloatArray:
    """Return a signal ``(F, K)`` with unknown frames interpolated."""
    if rotation:
        rotations = signal.copy()
        rotations[is_known] = so3.align_signs(signal[is_known], signal[is_known][0])
        signal = rotations
    lowpass_filter = lowpass_rotations if rotation else lowpass
    bridged = lowpass_filter(signal, BRIDGE_CUTOFF, 1.0, order=3, is_valid=is_known)
    return np.where(is_known[:, None], signal, bridged)


def _spike_frames(
    signal: FloatArray, max_length: int, min_size: float, *, rotation: bool
) -> BoolArray:
    """Return a mask ``(F,)`` of the frames of a signal ``(F, K)`` within a spike."""
    is_spike = np.zeros(len(signal), np.bool_)
    for _ in range(MAX_SPIKE_SEARCHES if max_length else 0):
        spikes = np.zeros_like(is_spike)
        threshold = SPIKE_FACTOR * _roughness(signal) + min_size
        for length, size in _run_deviations(signal, max_length, rotation=rotation):
            # A long spike also looks like a short one in its middle.
            for first in np.flatnonzero(size > threshold[2 : 2 + len(size)]).tolist():
                span = slice(first + 2, first + 2 + length)
                if not spikes[span.start - 1 : span.stop + 1].any():
                    spikes[span] = True
        if not spikes.any() or (is_spike | spikes).mean() > 0.5:
            break
        is_spike |= spikes
        signal = bridge_gaps(signal, ~is_spike, rotation=rotation)
    return is_spike


def _run_deviations(
    signal: FloatArray, max_length: int, *, rotation: bool
) -> Iterator[tuple[int, FloatArray]]:
    """Yield the length of runs, and the deviations of the runs from frame 2 on."""
    for run in range(max_length, 0, -1):
        count = len(signal) - run - 3
        if count < 1:
            continue
        shifts = [signal[k : k + count] for k in range(run + 4)]
        if rotation:  # sign flips after a spike are not rotation
            aligned_pairs = (run + 2, 1), (run + 3, run + 2), (2, 1), (run + 1, run + 2)
            for k, reference in aligned_pairs:
                shifts[k] = so3.align_to(shifts[k], shifts[reference])
        before, after = shifts[1], shifts[run + 2]
        forward, backward = 2 * before - shifts[0], 2 * after - shifts[run + 3]
        step = (after - before) / (run + 1)
        sizes = []
        for difference, deviation in (
            (shifts[2] - forward, shifts[2] - before - step),
            (shifts[run + 1] - backward, shifts[run + 1] - after + step),
        ):
            distance = np.linalg.norm(deviation, axis=-1)
            divisor = np.where(distance > 0, distance, 1)
            projection = np.sum(difference * deviation, axis=-1) / divisor
            sizes += [distance, projection]
        yield run, np.min(sizes, axis=0)


def _roughness(signal: FloatArray) -> FloatArray:
    """Return the running median of second differences around each frame ``(F,)``."""
    if len(signal) < 3:
        return np.zeros(len(signal))
    second_differences = np.linalg.norm(np.diff(signal, 2, axis=0), axis=-1)
    width = min(2 * ROUGHNESS_FRAMES + 1, len(second_differences))
    windows = np.lib.stride_tricks.sliding_window_view(second_differences, width)
    window_indices = np.arange(len(signal)) - 1 - width // 2
    return np.asarray(
        np.median(windows, axis=-1)[np.clip(window_indices, 0, len(windows) - 1)]
    )


_DEFAULTS = CleanOptions()


def clean(
    take: Take,
    *,
    spikes: int = _DEFAULTS.spikes,
    keep_noise: bool = _DEFAULTS.keep_noise,
    cutoff: float | None = None,
) -> Take:
    """Return a take without spikes, its joints low-pass filtered by their noise.

    Filters have no lag. A joint whose noise a filter would barely reduce is not
    filtered, so that a take without noise stays unchanged. A note lists what was done
    (CAP101).

    Args:
        take: A take of F frames.
        spikes: Longest spike that is removed [frames]; 0 keeps all.
        keep_noise: Whether to skip filtering.
        cutoff: Filter every joint at this frequency [Hz]; None chooses one for the
            translations and one for the rotations of each joint.
    """
    options = CleanOptions(spikes, keep_noise, cutoff)
    for check in _option_checks(options).values():
        check()
    cleaned_take, signals = clean_take(take, options)
    return replace(
        cleaned_take,
        notices=(*take.notices, *cleaning_notices(take, signals, options)),
    )


def clean_take(take: Take, options: CleanOptions) -> tuple[Take, list[CleanedSignal]]:
    """Return a cleaned take, and the cleaning results of the joints that move."""
    motion = take.motion
    cleaner = _JointCleaner(tuple(take.rig.names), float(take.clock.rate), options)
    min_shift = MIN_SPIKE_SHIFT * rest_size(take.rig)
    translations = cleaner.clean_channel(motion.translations, min_shift)
    rotations = cleaner.clean_channel(motion.rotations, MIN_SPIKE_ROTATION)
    dense = so3.align_signs(rotations.values, rotations.rest[rotations.animated])
    rotations = replace(rotations, values=dense)
    motion = replace(motion, translations=translations, rotations=rotations)
    return replace(take, motion=motion), cleaner.signals


def cleaning_notices(
    take: Take, signals: list[CleanedSignal], options: CleanOptions
) -> list[Fault]:
    """Return notices about a cleaned take."""
    if (
        take.clock.count <= NOISE_ORDER
        and not options.keep_noise
        and options.cutoff is None
    ):
        message = f"a take of {counted(take.clock.count, 'frame')} is too short to "
        message += "tell noise from motion; nothing is filtered"
        return [warning("CAP102", message)]
    joints_with_spikes = sorted({s.joint for s in signals if s.spikes})
    filtered_signals = [s for s in signals if s.cutoff is not None]
    faults, signal_parts, rate = [], [], float(take.clock.rate)
    if is_above_nyquist(options, rate) and not options.keep_noise:
        message = (
            f"a cut-off of {options.cutoff:g} Hz removes nothing from a take at "
            f"{rate:g} fps, whose highest frequency is {rate / 2:g} Hz; nothing is "
            "filtered"
        )
        hint = f"set {argument('cutoff')} below {rate / 2:g}; 6 Hz suits most body "
        hint += "motion"
        faults.append(warning("CAP106", message, hint))
    worst = _removed_motion(filtered_signals)
    if worst is not None:
        message = (
            f"a cut-off of {options.cutoff:g} Hz removes motion, not only noise: "
            f"{worst.name} changes by up to {worst.text(worst.max_change)}, its "
            f"noise is {worst.text(worst.noise)}"
        )
        hint = f"set {argument('cutoff')} in Hz; 6 Hz suits most body motion"
        faults.append(warning("CAP106", message, hint))
    if joints_with_spikes:
        frames = sum(len(s.spikes) for s in signals)
        names = listed(joints_with_spikes, MAX_LISTED_JOINTS)
        signal_parts.append(f"{counted(frames, 'frame')} of spikes replaced ({names})")
    if filtered_signals:
        signal_parts.append(_cutoff_text(filtered_signals, len(signals)))
    if signal_parts:
        faults.append(Fault("CAP101", "; ".join(signal_parts), severity=Severity.NOTE))
    return faults


def _removed_motion(signals: list[CleanedSignal]) -> CleanedSignal | None:
    """Return the signal that the filter changes most, or None if most motion is kept.

    Only rotations are compared if there are any, since the root often moves slowly.
    """
    signals = [s for s in signals if s.rotation] or signals
    affected = [s for s in signals if s.change > NOISE_FACTOR * s.noise]
    removed_power = sum(s.change**2 for s in affected)
    if not affected or removed_power <= MAX_REMOVED * sum(s.motion**2 for s in signals):
        return None
    return max(affected, key=lambda s: s.max_change)


def _cutoff_text(signals: list[CleanedSignal], count: int) -> str:
    """Return text that states the range of cut-off frequencies and the noise."""
    order = sorted(signals, key=lambda s: s.cutoff or 0.0)
    lowest, highest = order[0], order[-1]
    text = (
        f"{len(signals)} of {counted(count, 'signal')} filtered, at "
        f"{lowest.cutoff:.3g} Hz ({lowest.joint}) to "
        f"{highest.cutoff:.3g} Hz ({highest.joint})"
    )
    shift = max((s.noise for s in signals if not s.rotation), default=0.0)
    noise = max((s.noise for s in signals if s.rotation), default=0.0)
    return f"{text}; noise up to {length_text(shift)} and {math.degrees(noise):.2g} deg"


def noise_scores(frames: int, signals: list[CleanedSignal]) -> PassScores:
    """Return the noise scores of a take, and its cleaned joints, the worst first."""
    filtered_signals = sorted(
        (s for s in signals if s.cutoff is not None), key=lambda s: s.cutoff or 0.0
    )
    signals_with_spikes = sorted(
        (s for s in signals if s.spikes), key=lambda s: -len(s.spikes)
    )
    spike_frames = len({frame for s in signals for frame in s.spikes})
    noises = (s.noise for s in signals if s.rotation)
    shifts = (s.noise for s in signals if not s.rotation)
    names = {
        "filtered": tuple(
            f"{s.name} at {s.cutoff:.3g} Hz, noise {s.text(s.noise)}"
            for s in filtered_signals
        ),
        "spikes": tuple(f"{s.name} in {len(s.spikes)}" for s in signals_with_spikes),
    }
    return PassScores(
        (
            Score("position noise", max(shifts, default=0.0), ScoreUnit.LENGTH, 1e-3),
            Score(
                "rotation noise",
                max(noises, default=0.0),
                ScoreUnit.ANGLE,
                TYPICAL_NOISE,
            ),
            Score(
                "frames with spikes",
                spike_frames / max(frames, 1),
                ScoreUnit.FRACTION,
                0.01,
            ),
        ),
        {score_name: joints for score_name, joints in names.items() if joints},
    )


def _check_spikes(spikes: int) -> None:
    """Raise if the longest spike is out of range."""
    limit = ROUGHNESS_FRAMES // 2
    if not 0 <= spikes <= limit:
        refuse("CAP001", f"spikes is {spikes}; it must be 0 to {limit}")


def _check_cutoff(cutoff: float | None) -> None:
    """Raise if the cut-off frequency is not positive and finite."""
    if cutoff is not None and not 0 < cutoff < math.inf:
        refuse("CAP001", f"cutoff is {cutoff:g} Hz; it must be above 0")


def _option_checks(options: CleanOptions) -> OptionChecks:
    """Return the checks of the options, by option name."""
    return {
        "spikes": lambda: _check_spikes(options.spikes),
        "cutoff": lambda: _check_cutoff(options.cutoff),
    }


def _run(take: Take, options: CleanOptions, context: PassContext) -> Take:
    """Run the pass: clean the take and report its noise."""
    cleaned_take, signals = clean_take(take, options)
    context.notices.extend(cleaning_notices(take, signals, options))
    context.scores.append(noise_scores(take.clock.count, signals))
    return cleaned_take


_EDITED_PARTS = frozenset({TakePart.JOINTS})

PASS = Pass(
    "clean",
    "Remove spikes and noise",
    CleanOptions,
    FrameScope.CLIP,
    _run,
    _option_checks,
    reads=_EDITED_PARTS | {TakePart.RIG, TakePart.CLOCK},
    changes=_EDITED_PARTS,
)
