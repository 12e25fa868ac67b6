"""Gaits from takes: walk cycles, split into steps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray
from animtool.core.errors import Fault, OptionError, warning
from animtool.core.record import dataclass
from animtool.edit.cycle import find_cycle
from animtool.edit.looping import loop
from animtool.maths import so3
from animtool.maths.runs import runs
from animtool.motion.contacts import FootContacts, find_contacts
from animtool.motion.take import Take
from animtool.retarget.transfer import middle_of_hips
from animtool.rig.kinematics import WorldTransforms, forward_kinematics
from animtool.rig.skeleton import Rig
from animtool.systems.crowds.gaits import (
    PHASE_COUNT,
    Gait,
    Gaits,
    Walker,
    rotations_about_x,
    sample_rows,
    standing_ankle,
    swing_progress,
)
from animtool.systems.crowds.ground import (
    rotate_about_y,
    rotations_about_y,
    wrap_angles,
)

# Speed below which a clip counts as standing, in leg lengths [1/s].
MIN_TRAVEL_SPEED = 0.2
# Bounds of the period of a gait, two steps [s].
MIN_PERIOD, MAX_PERIOD = 0.4, 2.5
# Cycles with a larger seam, relative to their motion, are rejected.
MAX_SEAM_FRACTION = 0.35
# Repeats of a cycle for step detection; the middle one has a cycle on both sides.
CYCLE_REPEATS = 3


def build_gaits(rig: Rig, takes: Sequence[tuple[str, Take]]) -> Gaits:
    """Return the gaits of a rig from takes, which are given with their names."""
    walker = Walker.from_rig(rig)
    gaits_by_kind: dict[str, list[Gait]] = {"moves": [], "stands": [], "reacts": []}
    for name, take in takes:
        kind, gait = _build_gait(walker, name, take)
        gaits_by_kind[kind].append(gait)
    moving_gaits, idle_gaits, reactions = gaits_by_kind.values()
    notices = []
    if not moving_gaits:
        message = "none of the clips walks: add one that moves ahead in even steps"
        raise OptionError(Fault("SIM149", message, where="gaits"))
    moving_gaits.sort(key=lambda gait: gait.speed)
    slowest = moving_gaits[0]
    if slowest.speed > RUNNING_FROUDE * np.sqrt(9.81 * walker.leg_length):
        message = f"no clip walks: {slowest.name!r}, which runs at {slowest.speed:.2g} "
        message += "m/s, is slowed down, with shorter steps"
        notices.append(warning("SIM150", message, "add a clip that walks"))
    if not idle_gaits:
        message = f"no clip stands still: agents stand as in {slowest.name!r} at foot "
        message += "contact"
        notices.append(warning("SIM150", message, "add a clip that stands still"))
        idle_gaits.append(
            replace(slowest, rotations=slowest.rotations[:1], hips=slowest.hips[:1])
        )
    return Gaits(
        walker, tuple(moving_gaits), idle_gaits[0], tuple(reactions), tuple(notices)
    )


# Square root of the Froude number above which people run.
RUNNING_FROUDE = 0.7


def headings_of(rotations: FloatArray) -> FloatArray:
    """Return the headings of rotations ``(…, 4)``: yaws about y [rad]."""
    return np.asarray(2 * np.arctan2(rotations[..., 1], rotations[..., 3]))


def _build_gait(walker: Walker, name: str, take: Take) -> tuple[str, Gait]:
    """Classify a clip (moves, stands or reacts), and return it as a gait."""
    world = take.motion.world(walker.rig)
    hips = middle_of_hips(walker.skeleton, world.positions)
    fps = float(take.clock.rate)
    distance = np.linalg.norm((hips[-1] - hips[0])[[0, 2]])
    duration = max(len(hips) - 1, 1) / fps
    try:
        cycle_frames = find_cycle(take, shortest=MIN_PERIOD, longest=MAX_PERIOD)
    except OptionError:
        cycle_frames = None
    travel_range = float(np.ptp(hips[:, [0, 2]], axis=0).max())
    if travel_range < MIN_TRAVEL_SPEED * walker.leg_length * min(duration, 1.0):
        return "stands", _clip_gait(walker, name, take, world)
    if (
        cycle_frames is None
        or cycle_frames.share > MAX_SEAM_FRACTION
        or distance < MIN_TRAVEL_SPEED * walker.leg_length * duration
    ):
        return "reacts", _clip_gait(walker, name, take, world)
    cycle = loop(take, cycle_frames.first, cycle_frames.last, repeats=CYCLE_REPEATS)
    gait = _cycle_gait(walker, name, cycle)
    if gait is None:
        return "reacts", _clip_gait(walker, name, take, world)
    return "moves", gait


@dataclass(frozen=True)
class CyclePath:
    """Path of a body over a cycle: an arc at constant speed."""

    begin: float  # first frame
    length: float  # length of a cycle [frames]
    origin: FloatArray  # (x, z) at the first frame (2,) [m]
    heading: float  # heading at the first frame [rad]
    velocity: FloatArray  # velocity in the frame of the body (2,) [m/frame]
    yaw_rate: float  # yaw rate [rad/frame]

    def headings(self, frames: FloatArray) -> FloatArray:
        """Return headings at frames ``(K,)`` [rad]."""
        return self.heading + self.yaw_rate * (frames - self.begin)

    def positions(self, frames: FloatArray) -> FloatArray:
        """Return the (x, z) points of the path at frames ``(K, 2)`` [m]."""
        return (
            self.origin
            + _arc_integrals(self.heading, self.yaw_rate, frames - self.begin)
            @ self.velocity
        )

    @staticmethod
    def fitted_to(hips: FloatArray, headings: FloatArray, length: int) -> CyclePath:
        """Return the path fitted to the second of three cycles ``(3 L, …)``."""
        frames = np.arange(length, 2 * length)
        yaw_rate = float(headings[2 * length] - headings[length]) / length
        heading = float((headings[frames] - yaw_rate * (frames - length)).mean())
        points = hips[:, [0, 2]]
        cycle_integral = _arc_integrals(heading, yaw_rate, np.array([float(length)]))[0]
        velocity = np.linalg.solve(cycle_integral, points[2 * length] - points[length])
        path = CyclePath(length, length, np.zeros(2), heading, velocity, yaw_rate)
        offsets = points[frames] - path.positions(frames.astype(float))
        return replace(path, origin=offsets.mean(axis=0))


def _arc_integrals(heading: float, yaw_rate: float, frames: FloatArray) -> FloatArray:
    """Return matrices ``(K, 2, 2)`` that integrate a velocity in a rotating frame."""
    end_headings = heading + yaw_rate * frames
    if abs(yaw_rate) < 1e-9:
        cosine, sine = np.cos(heading) * frames, np.sin(heading) * frames
    else:
        cosine = (np.sin(end_headings) - np.sin(heading)) / yaw_rate
        sine = (np.cos(heading) - np.cos(end_headings)) / yaw_rate
    x_row, z_row = np.stack([cosine, sine], -1), np.stack([-sine, cosine], -1)
    return np.stack([x_row, z_row], axis=-2)


def _cycle_gait(walker: Walker, name: str, take: Take) -> Gait | None:
    """Return the second of three cycles as a gait; None if it lacks two clear steps."""
    translations, rotations, _ = take.motion.dense()
    world = forward_kinematics(walker.rig, translations, rotations)
    length, fps = take.clock.count // CYCLE_REPEATS, float(take.clock.rate)
    hips = middle_of_hips(walker.skeleton, world.positions)
    path = CyclePath.fitted_to(hips, _hip_headings(walker, world), length)
    if path.velocity[1] <= abs(path.velocity[0]):
        return None
    ground = _ground_height(walker, world)
    stances = [_find_stance(walker, world, k, length, fps) for k in range(2)]
    if any(stance is None for stance in stances):
        return None
    left, right = (stance for stance in stances if stance is not None)
    right_phase = ((right.begin - left.begin) / length) % 1.0
    if not 0.2 < right_phase < 0.8:
        return None
    phases = np.arange(PHASE_COUNT) / PHASE_COUNT
    cycle_fractions = np.interp(phases, [0.0, 0.5, 1.0], [0.0, right_phase, 1.0])
    frames = left.begin + cycle_fractions * length
    frames = np.where(frames >= 2 * length, frames - length, frames)
    to_body = rotations_about_y(-path.headings(frames))
    origins = np.insert(path.positions(frames), 1, ground, axis=1)
    local_rotations = _interpolate(rotations, frames)
    local_rotations[:, 0] = so3.multiply(to_body, local_rotations[:, 0])
    roots = so3.rotate(to_body, sample_rows(world.positions[:, 0], frames) - origins)
    steps = [
        _build_step(walker, world, path, ground, k, stance)
        for k, stance in enumerate((left, right))
    ]
    return Gait(
        name,
        local_rotations,
        roots,
        length / fps,
        path.velocity * fps,
        path.yaw_rate * fps,
        np.array([(stance.end - stance.begin) / length for stance in (left, right)]),
        *(np.stack(arrays) for arrays in zip(*steps, strict=True)),
    )


@dataclass(frozen=True)
class FootStance:
    """A range of frames in which a foot is planted."""

    begin: int  # first frame
    end: int  # frame after the last
    is_flat: BoolArray  # mask of frames in which the foot is flat ``(F,)``


def _find_stance(
    walker: Walker, world: WorldTransforms, foot_index: int, length: int, fps: float
) -> FootStance | None:
    """Return the stance of a foot from the second cycle; None unless there is one."""
    _, _, foot, toe = walker.legs[foot_index]
    toe_positions = None if toe < 0 else world.positions[:, toe]
    contacts: FootContacts = find_contacts(
        world.positions[:, foot], toe_positions, fps, walker.leg_length
    )
    stances = [run for run in runs(contacts.any) if length <= run[0] < 2 * length]
    if len(stances) != 1 or not 0 < stances[0][1] - stances[0][0] < length:
        return None
    return FootStance(*stances[0], contacts.ankle & contacts.toe)


def _build_step(
    walker: Walker,
    world: WorldTransforms,
    path: CyclePath,
    ground: float,
    foot_index: int,
    stance: FootStance,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return a foot's landing pose, pitches, swing rotations and ankle offsets."""
    _, _, foot, toe = walker.legs[foot_index]
    level, ball = walker.level_rotations[foot_index], walker.ball_offsets[foot_index]
    stance_frames = np.arange(stance.begin, stance.end)
    flat_frames = stance_frames
    if stance.is_flat[stance_frames].any():
        flat_frames = stance_frames[stance.is_flat[stance_frames]]
    soles = so3.multiply(world.rotations[:, foot], so3.conjugate(level))
    yaw = float(np.unwrap(headings_of(soles[flat_frames])).mean())
    toe_positions = world.positions[:, toe if toe >= 0 else foot]
    ball_offset = so3.rotate(rotations_about_y(np.array(yaw)), ball)
    foothold = toe_positions[stance_frames].mean(axis=0) - ball_offset
    foothold = foothold[[0, 2]]
    # In the frame of the body, the foot lands there in every cycle.
    landing_frame = np.array([float(stance.begin)])
    (start,) = path.positions(landing_frame)
    (start_heading,) = path.headings(landing_frame)
    offset = rotate_about_y(foothold - start, -start_heading)
    step = np.append(offset, wrap_angles(yaw - start_heading))
    (end_point,) = path.positions(landing_frame + path.length)
    (end_heading,) = path.headings(landing_frame + path.length)
    next_point = end_point + rotate_about_y(offset, end_heading)
    next_foothold = np.append(next_point, yaw + end_heading - start_heading)
    fractions = np.linspace(0.0, 1.0, PHASE_COUNT)
    frames = stance.begin + fractions * (stance.end - stance.begin)
    stance_rotations = _interpolate(soles, frames)
    stance_rotations = so3.multiply(rotations_about_y(np.array(-yaw)), stance_rotations)
    pitches = 2 * np.arctan2(stance_rotations[:, 0], stance_rotations[:, 3])
    pitches = wrap_angles(pitches)
    frames = stance.end + fractions * (stance.begin + path.length - stance.end)
    progress = swing_progress(fractions)
    positions = foothold + progress[:, None] * (next_foothold[:2] - foothold)
    yaws = yaw + progress * (next_foothold[2] - yaw)
    to_path = rotations_about_y(-yaws)
    swings = so3.multiply(to_path, _interpolate(soles, frames))
    ankles = sample_rows(world.positions[:, foot], frames)
    lifts = so3.rotate(to_path, ankles - np.insert(positions, 1, ground, axis=1))
    # The swing ends with the pitches of the stance.
    for end, weights in ((-1, 1 - fractions), (0, fractions)):
        row = 0 if end else -1
        stance_rotation = rotations_about_x(pitches[end : end + 1 or None])
        swing_rotation = swings[row : row + 1 or None]
        correction = so3.multiply(stance_rotation, so3.conjugate(swing_rotation))
        swings = so3.multiply(so3.exp(weights[:, None] * so3.log(correction)), swings)
        ankle_change = (
            standing_ankle(walker, foot_index, stance_rotation)[0] - lifts[row]
        )
        lifts = lifts + weights[:, None] * ankle_change
    return step, pitches, swings, lifts


def _interpolate(rotations: FloatArray, frames: FloatArray) -> FloatArray:
    """Return rotations ``(F, …, 4)`` interpolated at fractional frames ``(K,)``."""
    interpolated_rotations = sample_rows(rotations, frames)
    return np.asarray(
        interpolated_rotations
        / np.linalg.norm(interpolated_rotations, axis=-1, keepdims=True)
    )


def _clip_gait(walker: Walker, name: str, take: Take, world: WorldTransforms) -> Gait:
    """Return a complete clip as a gait without steps, relative to the first hips."""
    _, rotations, _ = take.motion.dense()
    heading = _hip_headings(walker, world)[0]
    to_forward = rotations_about_y(np.array(-heading))
    hips = middle_of_hips(walker.skeleton, world.positions)
    origin = np.array([hips[0, 0], _ground_height(walker, world), hips[0, 2]])
    roots = so3.rotate(to_forward, world.positions[:, 0] - origin)
    local_rotations = rotations.copy()
    local_rotations[:, 0] = so3.multiply(to_forward, rotations[:, 0])
    seconds = max(take.clock.count - 1, 1) / float(take.clock.rate)
    return Gait(name, local_rotations, roots, seconds, np.zeros(2), 0.0)


def _hip_headings(walker: Walker, world: WorldTransforms) -> FloatArray:
    """Return the heading of the hips at each frame ``(F,)`` [rad]."""
    hips = max(walker.skeleton.first_joint("hips"), 0)
    rest = walker.skeleton.rotations[hips]
    rotations = so3.multiply(world.rotations[:, hips], so3.conjugate(rest))
    return np.unwrap(headings_of(rotations)) + walker.heading


def _ground_height(walker: Walker, world: WorldTransforms) -> float:
    """Return the height of the ground below planted feet [m]."""
    feet = [leg[2] for leg in walker.legs]
    heights = world.positions[:, feet, 1] - walker.ankle_heights
    return float(np.quantile(heights.min(axis=1), 0.1))
