"""Gaits from takes: walk cycles are cut into steps."""

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
from animtool.rig.kinematics import WorldTransforms, forward
from animtool.rig.skeleton import Rig
from animtool.systems.crowds.gaits import (
    PHASES,
    Gait,
    Gaits,
    Walker,
    about_side,
    eased,
    rows,
    standing_ankle,
)
from animtool.systems.crowds.ground import about_up, turned, wrapped

# Slower clips stand, in leg lengths per second [1/s].
STANDS = 0.2
# Period of a gait [s]: two steps.
SHORTEST, LONGEST = 0.4, 2.5
# Cycles with a larger seam, relative to their motion, are rejected.
SEAM = 0.35
# Repeats of a cycle for step detection: the middle one has both neighbours.
REPEATS = 3


def gaits_of(rig: Rig, takes: Sequence[tuple[str, Take]]) -> Gaits:
    """Return takes on a rig as gaits, by name.

    Raises:
        OptionError: The rig has no legs, or none of the takes goes anywhere (SIM149).
    """
    walker = Walker.of(rig)
    moving: list[Gait] = []
    idle: list[Gait] = []
    reactions: list[Gait] = []
    for name, take in takes:
        kind, gait = _gait(walker, name, take)
        {"moves": moving, "stands": idle, "reacts": reactions}[kind].append(gait)
    notices = []
    if not moving:
        message = "none of the clips walks: add one that moves ahead in even steps"
        raise OptionError(Fault("SIM149", message, where="gaits"))
    moving.sort(key=lambda gait: gait.speed)
    slowest = moving[0]
    if slowest.speed > RUNS * np.sqrt(9.81 * walker.leg):
        message = f"no clip walks: {slowest.name!r}, which runs at {slowest.speed:.2g} "
        message += "m/s, is slowed down, with shorter steps"
        notices.append(warning("SIM150", message, "add a clip that walks"))
    if not idle:
        message = (
            f"no clip stands still: agents stand as in {slowest.name!r} at foot contact"
        )
        notices.append(warning("SIM150", message, "add a clip that stands still"))
        idle.append(
            replace(slowest, rotations=slowest.rotations[:1], hips=slowest.hips[:1])
        )
    return Gaits(walker, tuple(moving), idle[0], tuple(reactions), tuple(notices))


# Froude number (square root) above which people run.
RUNS = 0.7


def heading_of(rotations: FloatArray) -> FloatArray:
    """Return headings of rotations ``(…, 4)``: yaw about y [rad]."""
    return np.asarray(2 * np.arctan2(rotations[..., 1], rotations[..., 3]))


def _gait(walker: Walker, name: str, take: Take) -> tuple[str, Gait]:
    """Return the kind of a take (moves, stands, reacts), and its gait."""
    world = take.motion.world(walker.rig)
    hips = middle_of_hips(walker.person, world.positions)
    fps = float(take.clock.rate)
    travelled = np.linalg.norm((hips[-1] - hips[0])[[0, 2]])
    seconds = max(len(hips) - 1, 1) / fps
    try:
        cycle_frames = find_cycle(take, shortest=SHORTEST, longest=LONGEST)
    except OptionError:
        cycle_frames = None
    ranged = float(np.ptp(hips[:, [0, 2]], axis=0).max())
    if ranged < STANDS * walker.leg * min(seconds, 1.0):
        return "stands", _uncut(walker, name, take, world)
    if (
        cycle_frames is None
        or cycle_frames.share > SEAM
        or travelled < STANDS * walker.leg * seconds
    ):
        return "reacts", _uncut(walker, name, take, world)
    cycle = loop(take, cycle_frames.first, cycle_frames.last, repeats=REPEATS)
    gait = _cycle(walker, name, cycle)
    return (
        ("reacts", _uncut(walker, name, take, world))
        if gait is None
        else ("moves", gait)
    )


@dataclass(frozen=True)
class CyclePath:
    """The path of a body over a cycle: an arc at constant speed.

    Attributes:
        begin: Frame of the begin.
        length: Of a cycle [frames].
        origin: Where it is there: x and z ``(2,)`` [m].
        heading: Where it looks there [rad].
        velocity: In its own frame ``(2,)`` [m a frame].
        turning: [rad a frame].
    """

    begin: float
    length: float
    origin: FloatArray
    heading: float
    velocity: FloatArray
    turning: float

    def headings(self, frames: FloatArray) -> FloatArray:
        """Return headings ``(K,)`` [rad]."""
        return self.heading + self.turning * (frames - self.begin)

    def positions(self, frames: FloatArray) -> FloatArray:
        """Return x and z ``(K, 2)`` [m]."""
        return (
            self.origin
            + _arc(self.heading, self.turning, frames - self.begin) @ self.velocity
        )

    @staticmethod
    def of(hips: FloatArray, headings: FloatArray, length: int) -> CyclePath:
        """Return the path of the second of three cycles ``(3 L, …)``."""
        within = np.arange(length, 2 * length)
        turning = float(headings[2 * length] - headings[length]) / length
        heading = float((headings[within] - turning * (within - length)).mean())
        flat = hips[:, [0, 2]]
        cycle = _arc(heading, turning, np.array([float(length)]))[0]
        velocity = np.linalg.solve(cycle, flat[2 * length] - flat[length])
        body = CyclePath(length, length, np.zeros(2), heading, velocity, turning)
        off = flat[within] - body.positions(within.astype(float))
        return replace(body, origin=off.mean(axis=0))


def _arc(heading: float, turning: float, t: FloatArray) -> FloatArray:
    """Return integrals of velocity in a rotating frame, as matrices ``(K, 2, 2)``."""
    end = heading + turning * t
    if abs(turning) < 1e-9:
        cosine, sine = np.cos(heading) * t, np.sin(heading) * t
    else:
        cosine = (np.sin(end) - np.sin(heading)) / turning
        sine = (np.cos(heading) - np.cos(end)) / turning
    return np.stack(
        [np.stack([cosine, sine], axis=-1), np.stack([-sine, cosine], axis=-1)], axis=-2
    )


def _cycle(walker: Walker, name: str, take: Take) -> Gait | None:
    """Return the second of three cycles as a gait; None without exactly two steps."""
    translations, rotations, _ = take.motion.dense()
    world = forward(walker.rig, translations, rotations)
    length, fps = take.clock.count // REPEATS, float(take.clock.rate)
    hips = middle_of_hips(walker.person, world.positions)
    body = CyclePath.of(hips, _headings(walker, world), length)
    if body.velocity[1] <= abs(body.velocity[0]):
        return None
    ground = _ground(walker, world)
    stances = [_stance(walker, world, k, length, fps) for k in range(2)]
    if any(one is None for one in stances):
        return None
    left, right = (one for one in stances if one is not None)
    middle = ((right.lands - left.lands) / length) % 1.0
    if not 0.2 < middle < 0.8:
        return None
    phases = np.arange(PHASES) / PHASES
    shares = np.interp(phases, [0.0, 0.5, 1.0], [0.0, middle, 1.0])
    frames = left.lands + shares * length
    frames = np.where(frames >= 2 * length, frames - length, frames)
    back = about_up(-body.headings(frames))
    origins = np.insert(body.positions(frames), 1, ground, axis=1)
    local = _between(rotations, frames)
    local[:, 0] = so3.multiply(back, local[:, 0])
    root = so3.rotate(back, rows(world.positions[:, 0], frames) - origins)
    steps = [
        _step(walker, world, body, ground, k, one)
        for k, one in enumerate((left, right))
    ]
    return Gait(
        name,
        local,
        root,
        length / fps,
        body.velocity * fps,
        body.turning * fps,
        np.array([(one.lifts - one.lands) / length for one in (left, right)]),
        *(np.stack(each) for each in zip(*steps, strict=True)),
    )


@dataclass(frozen=True)
class FootStance:
    """The frames in which a foot is planted, and is flat."""

    lands: int
    lifts: int
    flat: BoolArray  # by frame


def _stance(
    walker: Walker, world: WorldTransforms, k: int, length: int, fps: float
) -> FootStance | None:
    """Return a foot's single stance that begins in the second cycle, or None."""
    _, _, foot, toe = walker.legs[k]
    tip = None if toe < 0 else world.positions[:, toe]
    contacts: FootContacts = find_contacts(
        world.positions[:, foot], tip, fps, walker.leg
    )
    begun = [one for one in runs(contacts.any) if length <= one[0] < 2 * length]
    if len(begun) != 1 or not 0 < begun[0][1] - begun[0][0] < length:
        return None
    return FootStance(*begun[0], contacts.ankle & contacts.toe)


def _step(
    walker: Walker,
    world: WorldTransforms,
    body: CyclePath,
    ground: float,
    k: int,
    stance: FootStance,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return a step's landing, pitches, and swing rotations and lifts."""
    _, _, foot, toe = walker.legs[k]
    level, ball = walker.level[k], walker.ball[k]
    within = np.arange(stance.lands, stance.lifts)
    flat = within[stance.flat[within]] if stance.flat[within].any() else within
    soles = so3.multiply(world.rotations[:, foot], so3.conjugate(level))
    yaw = float(np.unwrap(heading_of(soles[flat])).mean())
    ends = world.positions[:, toe if toe >= 0 else foot]
    foothold = ends[within].mean(axis=0) - so3.rotate(about_up(np.array(yaw)), ball)
    foothold = foothold[[0, 2]]
    # In the frame of the body: it lands there, and again a cycle later.
    land = np.array([float(stance.lands)])
    (here,), (look,) = body.positions(land), body.headings(land)
    step = np.append(turned(foothold - here, -look), wrapped(yaw - look))
    (there,), (then,) = (
        body.positions(land + body.length),
        body.headings(land + body.length),
    )
    later = np.append(there + turned(step[:2], then), yaw + then - look)
    shares = np.linspace(0.0, 1.0, PHASES)
    stands = _between(soles, stance.lands + shares * (stance.lifts - stance.lands))
    stands = so3.multiply(about_up(np.array(-yaw)), stands)
    pitches = 2 * np.arctan2(stands[:, 0], stands[:, 3])
    pitches = wrapped(pitches)
    frames = stance.lifts + shares * (stance.lands + body.length - stance.lifts)
    moved = eased(shares)
    positions = foothold + moved[:, None] * (later[:2] - foothold)
    yaws = yaw + moved * (later[2] - yaw)
    back = about_up(-yaws)
    swings = so3.multiply(back, _between(soles, frames))
    ankles = rows(world.positions[:, foot], frames) - np.insert(
        positions, 1, ground, axis=1
    )
    lifts = so3.rotate(back, ankles)
    # The swing ends with the pitches of the stance.
    for end, fade in ((-1, 1 - shares), (0, shares)):
        at = 0 if end else -1
        stood = about_side(pitches[end : end + 1 or None])
        miss = so3.multiply(stood, so3.conjugate(swings[at : at + 1 or None]))
        swings = so3.multiply(so3.exp(fade[:, None] * so3.log(miss)), swings)
        lifts = lifts + fade[:, None] * (
            standing_ankle(walker, k, stood)[0] - lifts[at]
        )
    return step, pitches, swings, lifts


def _between(rotations: FloatArray, frames: FloatArray) -> FloatArray:
    """Return rotations ``(F, …, 4)`` interpolated at frames ``(K,)``."""
    blended = rows(rotations, frames)
    return np.asarray(blended / np.linalg.norm(blended, axis=-1, keepdims=True))


def _uncut(walker: Walker, name: str, take: Take, world: WorldTransforms) -> Gait:
    """Return an uncut take as a gait, relative to its first hip position."""
    _, rotations, _ = take.motion.dense()
    heading = _headings(walker, world)[0]
    back = about_up(np.array(-heading))
    hips = middle_of_hips(walker.person, world.positions)
    origin = np.array([hips[0, 0], _ground(walker, world), hips[0, 2]])
    root = so3.rotate(back, world.positions[:, 0] - origin)
    local = rotations.copy()
    local[:, 0] = so3.multiply(back, rotations[:, 0])
    seconds = max(take.clock.count - 1, 1) / float(take.clock.rate)
    return Gait(name, local, root, seconds, np.zeros(2), 0.0)


def _headings(walker: Walker, world: WorldTransforms) -> FloatArray:
    """Return the heading of the hips over time ``(F,)`` [rad]."""
    hips = max(walker.person.first("hips"), 0)
    rest = walker.person.rotations[hips]
    turned = so3.multiply(world.rotations[:, hips], so3.conjugate(rest))
    return np.unwrap(heading_of(turned)) + walker.heading


def _ground(walker: Walker, world: WorldTransforms) -> float:
    """Return the height of the ground below planted feet [m]."""
    feet = [leg[2] for leg in walker.legs]
    heights = world.positions[:, feet, 1] - walker.ankle
    return float(np.quantile(heights.min(axis=1), 0.1))
