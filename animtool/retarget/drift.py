"""Measures the drift of captured roots from planted feet, and removes it.

Inertial suits slowly lose their position and heading. A planted foot does not move, so
its apparent motion is the root's drift. On level ground all planted feet are at the
same height.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TypeAlias, TypeVar

import numpy as np
import numpy.typing as npt

from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault, OptionError, Severity
from animtool.core.quantities import angle_text, length_text
from animtool.core.record import dataclass
from animtool.core.units import UpAxis
from animtool.maths import so3
from animtool.maths.filters import lowpass
from animtool.maths.runs import runs
from animtool.motion.contacts import find_contacts
from animtool.motion.passes import FrameScope, Pass, PassContext, TakePart
from animtool.motion.take import Take
from animtool.retarget.feet_pass import no_body_warning
from animtool.retarget.pairing import map_joints
from animtool.retarget.roled_skeleton import RoledSkeleton

ComplexArray: TypeAlias = npt.NDArray[np.complex128]
RealOrComplexArray = TypeVar("RealOrComplexArray", FloatArray, ComplexArray)
# Upper frequency limit of drift, and lower frequency limit of steps [Hz].
DRIFT_FREQUENCY, STEP_FREQUENCY = 0.1, 0.4
# Half width of the window in which drift is the median of contacts [s].
WINDOW_SECONDS = 10.0
# Fraction of a contact at either end during which the foot lands or lifts.
LANDING_FRACTION = 0.2
# A speed estimate needs at least this many frames.
MIN_STANCE_FRAMES = 4


@dataclass(frozen=True, slots=True)
class DriftOptions:
    """Which components of the root's drift are removed.

    Attributes:
        place: Whether the position on the ground drifts.
        heading: Whether the rotation about the vertical drifts; feet that intentionally
            pivot most of the time look the same.
        height: Whether the height drifts; requires level ground.
        closed: Whether the take ends where it begins, with the same heading; the
            remaining drift is then distributed over it.
        map: A map file that names leg and foot joints; None detects them.
    """

    place: bool = True
    heading: bool = False
    height: bool = True
    closed: bool = False
    map: Path | None = None


@dataclass(frozen=True, slots=True)
class _StanceTracks:
    """Position, speed, spin and height of planted feet, smoothed over all frames.

    Ground positions are complex numbers: a rotation about the vertical is a factor.
    """

    position: ComplexArray  # ground position of planted feet (F,) [m]
    velocity: ComplexArray  # velocity minus that of spin about the origin (F,) [m/s]
    spin: FloatArray  # angular velocity about the vertical (F,) [rad/s]
    height: FloatArray  # height of the feet above its median (F,) [m]


def remove_drift(take: Take, options: DriftOptions, context: PassContext) -> Take:
    """Return a take whose root does not drift; its local pose is unchanged."""
    path = None if options.map is None else context.folder / options.map
    try:
        joint_map = map_joints(take.rig, take.rig, map_file=path)
    except OptionError as error:
        context.notices.append(no_body_warning(error))
        return take
    skeleton = RoledSkeleton.of(take.rig, joint_map.source.roles)
    stance = _stance_tracks(take, skeleton, measures_spin=options.heading)
    if stance is None:
        message = "no foot is planted long enough to measure drift: nothing is changed"
        context.notices.append(Fault("CAP103", message, severity=Severity.WARNING))
        return take
    source_motion, root_index = take.motion, np.array([take.rig.roots[0]])
    root_positions, rotations = (
        channel.gather(root_index)[:, 0]
        for channel in (source_motion.translations, source_motion.rotations)
    )
    up, (a, b) = _ground_axes(take)
    root_on_ground = root_positions[:, a] + 1j * root_positions[:, b]
    correction_angle, shift = _root_correction(
        take, options, stance, root_on_ground, rotations
    )
    corrected_positions = root_positions.copy()
    corrected_ground = np.exp(1j * correction_angle) * root_on_ground + shift
    corrected_positions[:, a], corrected_positions[:, b] = (
        corrected_ground.real,
        corrected_ground.imag,
    )
    if options.height:
        corrected_positions[:, up] -= stance.height
    rotation = so3.from_axis_angle(np.eye(3)[up], correction_angle)
    corrected_rotations = so3.align_signs(so3.multiply(rotation, rotations))
    motion = replace(
        source_motion,
        translations=source_motion.translations.put(
            root_index, corrected_positions[:, None]
        ),
        rotations=source_motion.rotations.put(root_index, corrected_rotations[:, None]),
    )
    largest_shift = float(
        np.linalg.norm(corrected_positions - root_positions, axis=1).max()
    )
    degrees = float(np.degrees(np.abs(correction_angle)).max())
    message = f"the root is moved by up to {length_text(largest_shift)} and rotated by "
    message += f"up to {angle_text(degrees)}, measured from planted feet"
    context.notices.append(Fault("CAP104", message, severity=Severity.NOTE))
    return replace(take, motion=motion)


def _ground_axes(take: Take) -> tuple[int, tuple[int, int]]:
    """Return the vertical axis and the two ground axes, right-handed about it."""
    return (1, (2, 0)) if take.rig.up is UpAxis.Y else (2, (0, 1))


def _root_correction(
    take: Take,
    options: DriftOptions,
    stance: _StanceTracks,
    root_on_ground: ComplexArray,
    root_rotations: FloatArray,
) -> tuple[FloatArray, ComplexArray]:
    """Return the root's correction: rotation ``(F,)`` [rad] and shift ``(F,)`` [m].

    With it, planted feet stay in place: ``e^(i angle) position + shift`` is constant.
    """
    rate, up = float(take.clock.rate), _ground_axes(take)[0]
    spin = -stance.spin
    velocity = stance.velocity if options.place else np.zeros(len(root_on_ground))
    angle = _integrate(spin, rate)
    if options.closed:
        first, last = root_rotations[0], root_rotations[-1]
        heading_change = so3.multiply(last, so3.conjugate(first))
        heading_error = _angle_about_up(heading_change[None], up)[0] + angle[-1]
        spin = spin - (heading_error / max(len(root_on_ground) - 1, 1)) * rate
        angle = _integrate(spin, rate)
    residual_spin_velocity = 1j * (stance.spin + spin) * stance.position
    shift_rate = -np.exp(1j * angle) * (velocity + residual_spin_velocity)
    shift = _integrate(shift_rate, rate)
    if options.closed:
        ends = [0, -1]
        start, end = np.exp(1j * angle[ends]) * root_on_ground[ends] + shift[ends]
        shift = shift - (end - start) * np.linspace(0.0, 1.0, len(root_on_ground))
    return angle, shift


def _integrate(values: RealOrComplexArray, rate: float) -> RealOrComplexArray:
    """Integrate values over time by the trapezoidal rule, starting from 0."""
    integral = np.zeros_like(values)
    integral[1:] = np.cumsum((values[1:] + values[:-1]) / 2) / rate
    return integral


def _angle_about_up(rotations: FloatArray, up: int) -> FloatArray:
    """Return the angle of rotations ``(N, 4)`` about the vertical ``(N,)`` [rad]."""
    angles = 2 * np.arctan2(rotations[:, up], rotations[:, 3])
    return np.asarray(np.angle(np.exp(1j * angles)))


def _stance_tracks(
    take: Take, skeleton: RoledSkeleton, *, measures_spin: bool
) -> _StanceTracks | None:
    """Return the motion of planted feet; None if none is planted for long."""
    up, (first_axis, second_axis) = _ground_axes(take)
    rate = float(take.clock.rate)
    frame_count = take.clock.count
    world = take.world()
    position_sums, contact_counts = np.zeros((frame_count, 3)), np.zeros(frame_count)
    # Per contact: its middle, duration, spin, speed and position.
    contact_rows: list[list[float]] = []
    for side in "lr":
        leg = skeleton.leg(side)
        if leg is None:
            continue
        ankle = world.positions[:, leg[2]]
        toe = world.positions[:, leg[3]] if leg[3] >= 0 else ankle
        is_planted = find_contacts(ankle, toe, rate, skeleton.leg_length(side), up).any
        rotations = so3.from_matrix(world.linear[:, leg[2]])
        for start, end in runs(is_planted):
            landing_frames = round(LANDING_FRACTION * (end - start))
            stance_frames = slice(start + landing_frames, end - landing_frames)
            if stance_frames.stop - stance_frames.start < MIN_STANCE_FRAMES:
                continue
            # A foot that rolls over its toe moves its ankle.
            velocities = [
                _least_squares_rate(path[stance_frames], rate) for path in (ankle, toe)
            ]
            pivot, velocity = ankle, velocities[0]
            if np.linalg.norm(velocities[1]) < np.linalg.norm(velocity):
                pivot, velocity = toe, velocities[1]
            ground_height = float(np.median(pivot[is_planted, up]))
            inverse_start = so3.conjugate(rotations[stance_frames.start])
            relative_rotations = so3.multiply(rotations[stance_frames], inverse_start)
            headings = np.unwrap(_angle_about_up(relative_rotations, up))
            spin = 0.0
            if measures_spin:
                spin = float(_least_squares_rate(headings[:, None], rate)[0])
            length = stance_frames.stop - stance_frames.start
            middle_frame = (stance_frames.start + stance_frames.stop - 1) / 2
            mean_position = pivot[stance_frames].mean(axis=0)
            ground_values = [
                *velocity[[first_axis, second_axis]],
                *mean_position[[first_axis, second_axis]],
            ]
            contact_rows.append([middle_frame, length, spin, *ground_values])
            positions = pivot[stance_frames][:, [first_axis, second_axis, up]] - [
                0.0,
                0.0,
                ground_height,
            ]
            position_sums[stance_frames] += positions
            contact_counts[stance_frames] += 1
    if (contact_counts > 0).sum() <= MIN_STANCE_FRAMES:
        return None
    contacts = np.array(sorted(contact_rows))
    window, frames = WINDOW_SECONDS * rate, np.arange(frame_count)
    smooth_spin = _windowed_medians(contacts, 2, window)
    # Remove the motion caused by the spin about the origin.
    contacts[:, 3] += smooth_spin * contacts[:, 6]
    contacts[:, 4] -= smooth_spin * contacts[:, 5]
    medians = [smooth_spin, *(_windowed_medians(contacts, k, window) for k in (3, 4))]
    median_tracks = [np.interp(frames, contacts[:, 0], column) for column in medians]
    drift = lowpass(np.stack(median_tracks, axis=1), DRIFT_FREQUENCY, rate)
    position_sums /= np.maximum(contact_counts, 1)[:, None]
    is_measured = contact_counts > 0
    position = lowpass(position_sums[:, :2], STEP_FREQUENCY, rate, is_valid=is_measured)
    height = lowpass(position_sums[:, 2], DRIFT_FREQUENCY, rate, is_valid=is_measured)
    return _StanceTracks(
        position[:, 0] + 1j * position[:, 1],
        drift[:, 1] + 1j * drift[:, 2],
        drift[:, 0],
        height - float(np.median(height)),
    )


def _windowed_medians(contacts: FloatArray, column: int, window: float) -> FloatArray:
    """Return the weighted moving median of a contact column ``(N,)``.

    Contacts are weighted by duration, so that a foot that slides intentionally is
    outvoted.
    """
    medians = np.zeros(len(contacts))
    for i, middle_frame in enumerate(contacts[:, 0].tolist()):
        nearby_contacts = contacts[np.abs(contacts[:, 0] - middle_frame) <= window]
        order = np.argsort(nearby_contacts[:, column], kind="stable")
        weight_sums = np.cumsum(nearby_contacts[order, 1])
        middle_index = int(np.searchsorted(weight_sums, weight_sums[-1] / 2))
        medians[i] = nearby_contacts[order[middle_index], column]
    return medians


def _least_squares_rate(values: FloatArray, rate: float) -> FloatArray:
    """Return the least-squares rate of rows ``(N, K)`` per second ``(K,)`` [1/s]."""
    times = (np.arange(len(values)) - (len(values) - 1) / 2) / rate
    return np.asarray(times @ values / (times @ times))


PASS = Pass(
    "root_drift",
    "Remove the drift of a captured root",
    DriftOptions,
    FrameScope.CLIP,
    remove_drift,
    reads=frozenset({TakePart.RIG, TakePart.JOINTS, TakePart.CLOCK}),
    changes=frozenset({TakePart.JOINTS}),
)
