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
from animtool.rig.kinematics import rest_size, rest_world
from animtool.rig.skeleton import Rig

# Minimum size of a spike, relative to the typical change of speed around it.
SPIKE_ROUGHNESS_RATIO = 5.0
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
MAX_REMOVED_POWER = 0.5
# A change of more than this many times the noise is motion.
MOTION_NOISE_RATIO = 5.0
# A walk filtered at 1 Hz moves its feet by less; a step or a swing of an arm that is
# filtered away moves them by more [size of the rig].
MAX_DISPLACEMENT = 0.15
# The largest change by noise alone is at most this multiple of its deviation [1].
DISPLACEMENT_NOISE_RATIO = 20.0
# Frames compared at once.
COMPARED_FRAMES = 1024
MAX_LISTED_JOINTS = 6


@dataclass(frozen=True, slots=True)
class CleanedSignal:
    """Spikes, noise and filter of one joint's translations or rotations."""

    joint: str
    is_rotation: bool  # whether the signal is rotations, not translations
    spikes: tuple[int, ...]  # frames that were replaced, ascending
    noise: float  # standard deviation before filtering [m] or [rad]
    cutoff: float | None  # cut-off frequency [Hz]; None if not filtered
    motion: float = 0.0  # root mean square deviation from the mean [m] or [rad]
    change: float = 0.0  # root mean square change by the filter [m] or [rad]
    max_change: float = 0.0  # largest change by the filter [m] or [rad]

    @property
    def name(self) -> str:
        """Name of the joint and its channel, such as ``hips rotation``."""
        return f"{self.joint} {'rotation' if self.is_rotation else 'translation'}"

    def text(self, value: float) -> str:
        """Return a value of the signal as text: an angle [rad] or a length [m]."""
        if self.is_rotation:
            return angle_text(math.degrees(value))
        return length_text(value)


@dataclass(slots=True)
class _JointCleaner:
    """Cleans the channels of a take joint by joint, and collects `CleanedSignal`s."""

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
            max_spike_length = self.options.spikes
            is_spike = _find_spikes(
                signal, max_spike_length, min_size, is_rotation=is_rotation
            )
            if is_spike.any():
                signal = bridge_gaps(signal, ~is_spike, is_rotation=is_rotation)
            noise = (rotation_noise if is_rotation else noise_level)(signal)
            # A quaternion contains half the angle.
            tolerance = noise / 2 if is_rotation else noise
            is_noisy = tolerance > NEGLIGIBLE_NOISE * min_size
            cutoff = (
                self._choose_cutoff(signal, is_rotation=is_rotation)
                if is_noisy or self.options.cutoff is not None
                else None
            )
            spike_frames = tuple(np.flatnonzero(is_spike).tolist())
            cleaned_signal = CleanedSignal(
                self.names[joint], is_rotation, spike_frames, noise, cutoff
            )
            if cutoff is not None:
                lowpass_filter = lowpass_rotations if is_rotation else lowpass
                filtered_signal = lowpass_filter(signal, cutoff, self.rate)
                if self.options.cutoff is not None:
                    mean = signal.mean(axis=0)
                    if cleaned_signal.is_rotation:
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

    def _choose_cutoff(self, signal: FloatArray, *, is_rotation: bool) -> float | None:
        """Return the cut-off frequency of a signal [Hz]; None leaves it unfiltered."""
        if self.options.keep_noise or is_above_nyquist(self.options, self.rate):
            return None
        if self.options.cutoff is not None:
            return self.options.cutoff
        return find_best_cutoff(signal, self.rate, is_rotation=is_rotation)


def is_above_nyquist(options: CleanOptions, rate: float) -> bool:
    """Return whether the chosen cut-off is at or above half the frame rate [Hz]."""
    return options.cutoff is not None and options.cutoff >= rate / 2


def bridge_gaps(
    signal: FloatArray, is_known: BoolArray, *, is_rotation: bool
) -> FloatArray:
    """Fill unknown frames of a signal ``(F, K)`` by a low-pass filter of the others."""
    if is_rotation:
        rotations = signal.copy()
        rotations[is_known] = so3.align_signs(signal[is_known], signal[is_known][0])
        signal = rotations
    lowpass_filter = lowpass_rotations if is_rotation else lowpass
    bridge_signal = lowpass_filter(
        signal, BRIDGE_CUTOFF, 1.0, order=3, is_valid=is_known
    )
    return np.where(is_known[:, None], signal, bridge_signal)


def _find_spikes(
    signal: FloatArray, max_length: int, min_size: float, *, is_rotation: bool
) -> BoolArray:
    """Return a mask ``(F,)`` of the frames of a signal ``(F, K)`` in a spike."""
    is_spike = np.zeros(len(signal), np.bool_)
    for _ in range(MAX_SPIKE_SEARCHES if max_length else 0):
        is_new_spike = np.zeros_like(is_spike)
        threshold = SPIKE_ROUGHNESS_RATIO * _roughness(signal) + min_size
        for length, size in _run_deviations(
            signal, max_length, is_rotation=is_rotation
        ):
            # A long spike also looks like a short one in its middle.
            for first in np.flatnonzero(size > threshold[2 : 2 + len(size)]).tolist():
                span = slice(first + 2, first + 2 + length)
                if not is_new_spike[span.start - 1 : span.stop + 1].any():
                    is_new_spike[span] = True
        if not is_new_spike.any() or (is_spike | is_new_spike).mean() > 0.5:
            break
        is_spike |= is_new_spike
        signal = bridge_gaps(signal, ~is_spike, is_rotation=is_rotation)
    return is_spike


def _run_deviations(
    signal: FloatArray, max_length: int, *, is_rotation: bool
) -> Iterator[tuple[int, FloatArray]]:
    """Yield each run length, and the smallest deviation of every run of that length."""
    for length in range(max_length, 0, -1):
        run_count = len(signal) - length - 3
        if run_count < 1:
            continue
        windows = [signal[k : k + run_count] for k in range(length + 4)]
        if is_rotation:  # sign flips after a spike are not rotation
            last = length + 2
            for k, reference in (last, 1), (last + 1, last), (2, 1), (last - 1, last):
                windows[k] = so3.align_to(windows[k], windows[reference])
        before, after = windows[1], windows[length + 2]
        forward, backward = 2 * before - windows[0], 2 * after - windows[length + 3]
        step = (after - before) / (length + 1)
        sizes = []
        for difference, deviation in (
            (windows[2] - forward, windows[2] - before - step),
            (windows[length + 1] - backward, windows[length + 1] - after + step),
        ):
            distance = np.linalg.norm(deviation, axis=-1)
            divisor = np.where(distance > 0, distance, 1)
            projection = np.sum(difference * deviation, axis=-1) / divisor
            sizes += [distance, projection]
        yield length, np.min(sizes, axis=0)


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

    Filters have no lag. Without a ``cutoff``, a joint whose noise a filter would barely
    reduce is not filtered, so that a take without noise stays unchanged. A note lists
    what was done (CAP101).

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
    notices = cleaning_notices(take, signals, options, cleaned_take)
    return replace(cleaned_take, notices=(*take.notices, *notices))


def clean_take(take: Take, options: CleanOptions) -> tuple[Take, list[CleanedSignal]]:
    """Remove spikes and noise from a take; return it, and a result for each signal."""
    motion = take.motion
    cleaner = _JointCleaner(tuple(take.rig.names), float(take.clock.rate), options)
    min_shift = MIN_SPIKE_SHIFT * rest_size(take.rig)
    translations = cleaner.clean_channel(motion.translations, min_shift)
    rotations = cleaner.clean_channel(motion.rotations, MIN_SPIKE_ROTATION)
    values = so3.align_signs(rotations.values, rotations.rest[rotations.animated])
    rotations = replace(rotations, values=values)
    motion = replace(motion, translations=translations, rotations=rotations)
    return replace(take, motion=motion), cleaner.signals


def cleaning_notices(
    take: Take,
    signals: list[CleanedSignal],
    options: CleanOptions,
    cleaned_take: Take | None = None,
) -> list[Fault]:
    """Return a note on what was cleaned, and warnings about cut-offs (CAP101-106).

    With the cleaned take, joints that the cut-off moves far are found too.
    """
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
    notices, summaries, rate = [], [], float(take.clock.rate)
    if is_above_nyquist(options, rate) and not options.keep_noise:
        message = (
            f"a cut-off of {options.cutoff:g} Hz removes nothing from a take at "
            f"{rate:g} fps, whose highest frequency is {rate / 2:g} Hz; nothing is "
            "filtered"
        )
        hint = f"set {argument('cutoff')} below {rate / 2:g}; 6 Hz suits most body "
        hint += "motion"
        notices.append(warning("CAP106", message, hint))
    worst_signal = _most_changed_signal(filtered_signals)
    if worst_signal is not None:
        message = (
            f"a cut-off of {options.cutoff:g} Hz removes motion, not only noise: "
            f"{worst_signal.name} changes by up to "
            f"{worst_signal.text(worst_signal.max_change)}, its "
            f"noise is {worst_signal.text(worst_signal.noise)}"
        )
        notices.append(warning("CAP106", message, _cutoff_hint(options, rate)))
    elif cleaned_take is not None and options.cutoff is not None and filtered_signals:
        notices += _displacement_warning(take, cleaned_take, signals, options)
    if joints_with_spikes:
        frames = sum(len(s.spikes) for s in signals)
        names = listed(joints_with_spikes, MAX_LISTED_JOINTS)
        summaries.append(f"{counted(frames, 'frame')} of spikes replaced ({names})")
    if filtered_signals:
        summaries.append(_cutoff_text(filtered_signals, len(signals)))
    if summaries:
        notices.append(Fault("CAP101", "; ".join(summaries), severity=Severity.NOTE))
    return notices


def _cutoff_hint(options: CleanOptions, rate: float) -> str:
    """Return a hint to set the cut-off in Hz, with what a normalized one would be."""
    hint = f"set {argument('cutoff')} in Hz; 6 Hz suits most body motion"
    cutoff = options.cutoff
    if cutoff is not None and cutoff < 1:
        hint += f"; {cutoff:g} of the highest frequency, {rate / 2:g} Hz, would be "
        hint += f"{cutoff * rate / 2:.3g} Hz"
    return hint


def _displacement_warning(
    take: Take, cleaned_take: Take, signals: list[CleanedSignal], options: CleanOptions
) -> list[Fault]:
    """Return a warning if a cut-off moves a joint far (CAP106).

    Frames with spikes are not compared; others must differ by more than the noise.
    """
    is_compared = np.ones(len(take), np.bool_)
    for signal in signals:
        is_compared[list(signal.spikes)] = False
    compared_frames = np.flatnonzero(is_compared)
    max_distance, max_joint, max_frame = 0.0, 0, 0
    for frames in np.array_split(
        compared_frames, max(1, len(compared_frames) // COMPARED_FRAMES)
    ):
        positions, cleaned_positions = (
            one.motion.select(frames).world(take.rig).positions
            for one in (take, cleaned_take)
        )
        distances = np.linalg.norm(cleaned_positions - positions, axis=-1)
        if distances.size and distances.max() > max_distance:
            i, joint = np.unravel_index(distances.argmax(), distances.shape)
            max_distance, max_joint = float(distances.max()), int(joint)
            max_frame = int(frames[i])
    min_distance = DISPLACEMENT_NOISE_RATIO * _noise_displacement(take.rig, signals)
    if max_distance <= max(MAX_DISPLACEMENT * rest_size(take.rig), min_distance):
        return []
    time_code = float(take.clock.start + max_frame * take.clock.step)
    noise = max((s.noise for s in signals if not s.is_rotation), default=0.0)
    message = (
        f"a cut-off of {options.cutoff:g} Hz moves {take.rig.names[max_joint]!r} by "
        f"{length_text(max_distance)} at frame {time_code:g}"
    )
    if noise:
        message += f", although the noise of positions is {length_text(noise)}"
    hint = _cutoff_hint(options, float(take.clock.rate))
    return [warning("CAP106", message, hint)]


def _noise_displacement(rig: Rig, signals: list[CleanedSignal]) -> float:
    """Return how far the noise of all joints displaces the farthest one at rest [m]."""
    positions = rest_world(rig).positions[0]
    translation_noises, rotation_noises = np.zeros((2, len(positions)))
    for signal in signals:
        noises = rotation_noises if signal.is_rotation else translation_noises
        noises[rig.index(signal.joint)] = signal.noise
    displacements = [0.0]
    for joint in range(len(positions)):
        chain = rig.upwards(joint)
        # Noise has three axes; a rotation about the direction of a joint does not
        # move it.
        distances = np.linalg.norm(positions[joint] - positions[chain], axis=-1)
        lever_noise = math.sqrt(2) * distances * rotation_noises[chain]
        chain_noise = math.sqrt(3) * translation_noises[chain]
        displacements.append(float(np.linalg.norm([lever_noise, chain_noise])))
    return max(displacements)


def _most_changed_signal(signals: list[CleanedSignal]) -> CleanedSignal | None:
    """Return the signal that a filter changes most if it removes motion; else None.

    Only rotations are compared if there are any, since the root often moves slowly.
    """
    signals = [s for s in signals if s.is_rotation] or signals
    changed_signals = [s for s in signals if s.change > MOTION_NOISE_RATIO * s.noise]
    removed_power = sum(s.change**2 for s in changed_signals)
    total_power = sum(s.motion**2 for s in signals)
    if not changed_signals or removed_power <= MAX_REMOVED_POWER * total_power:
        return None
    return max(changed_signals, key=lambda s: s.max_change)


def _cutoff_text(signals: list[CleanedSignal], signal_count: int) -> str:
    """Return text on how many signals are filtered, their cut-offs and their noise."""
    sorted_signals = sorted(signals, key=lambda s: s.cutoff or 0.0)
    lowest, highest = sorted_signals[0], sorted_signals[-1]
    text = (
        f"{len(signals)} of {counted(signal_count, 'signal')} filtered, at "
        f"{lowest.cutoff:.3g} Hz ({lowest.joint}) to "
        f"{highest.cutoff:.3g} Hz ({highest.joint})"
    )
    position_noise = max((s.noise for s in signals if not s.is_rotation), default=0.0)
    angle_noise = max((s.noise for s in signals if s.is_rotation), default=0.0)
    noise_text = f"{length_text(position_noise)} and {math.degrees(angle_noise):.2g}"
    return f"{text}; noise up to {noise_text} deg"


def noise_scores(frame_count: int, signals: list[CleanedSignal]) -> PassScores:
    """Return a take's largest noise and spike fraction as scores, with joint names."""
    filtered_signals = sorted(
        (s for s in signals if s.cutoff is not None), key=lambda s: s.cutoff or 0.0
    )
    signals_with_spikes = sorted(
        (s for s in signals if s.spikes), key=lambda s: -len(s.spikes)
    )
    spike_frames = len({frame for s in signals for frame in s.spikes})
    rotation_noises = (s.noise for s in signals if s.is_rotation)
    shift_noises = (s.noise for s in signals if not s.is_rotation)
    details_by_score = {
        "filtered": tuple(
            f"{s.name} at {s.cutoff:.3g} Hz, noise {s.text(s.noise)}"
            for s in filtered_signals
        ),
        "spikes": tuple(f"{s.name} in {len(s.spikes)}" for s in signals_with_spikes),
    }
    return PassScores(
        (
            Score(
                "position noise", max(shift_noises, default=0.0), ScoreUnit.LENGTH, 1e-3
            ),
            Score(
                "rotation noise",
                max(rotation_noises, default=0.0),
                ScoreUnit.ANGLE,
                TYPICAL_NOISE,
            ),
            Score(
                "frames with spikes",
                spike_frames / max(frame_count, 1),
                ScoreUnit.FRACTION,
                0.01,
            ),
        ),
        {
            score_name: details
            for score_name, details in details_by_score.items()
            if details
        },
    )


def _check_spikes(spikes: int) -> None:
    """Raise if the longest spike is below 0 or too long to detect [frames] (CAP001)."""
    max_spikes = ROUGHNESS_FRAMES // 2
    if not 0 <= spikes <= max_spikes:
        refuse("CAP001", f"spikes is {spikes}; it must be 0 to {max_spikes}")


def _check_cutoff(cutoff: float | None) -> None:
    """Raise if the cut-off frequency is not positive and finite [Hz] (CAP001)."""
    if cutoff is not None and not 0 < cutoff < math.inf:
        refuse("CAP001", f"cutoff is {cutoff:g} Hz; it must be above 0")


def _option_checks(options: CleanOptions) -> OptionChecks:
    """Return a function that checks the value, for each option that has limits."""
    return {
        "spikes": lambda: _check_spikes(options.spikes),
        "cutoff": lambda: _check_cutoff(options.cutoff),
    }


def _run_pass(take: Take, options: CleanOptions, context: PassContext) -> Take:
    """Run the pass: clean the take and report its noise."""
    cleaned_take, signals = clean_take(take, options)
    context.notices.extend(cleaning_notices(take, signals, options, cleaned_take))
    context.scores.append(noise_scores(take.clock.count, signals))
    return cleaned_take


_EDITED_PARTS = frozenset({TakePart.JOINTS})

PASS = Pass(
    "clean",
    "Remove spikes and noise",
    CleanOptions,
    FrameScope.CLIP,
    _run_pass,
    _option_checks,
    reads=_EDITED_PARTS | {TakePart.RIG, TakePart.CLOCK},
    changes=_EDITED_PARTS,
)
