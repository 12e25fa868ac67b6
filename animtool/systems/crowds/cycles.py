"""Takes on a rig as gaits: a cycle that goes somewhere is cut into its steps."""

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

# A clip whose hips go slower stands, over the length of a leg [1/s].
STANDS = 0.2
# Cycles of a gait [s]: two steps.
SHORTEST, LONGEST = 0.4, 2.5
# Ends of a cycle that differ by more than this part of what it moves are none.
SEAM = 0.35
# A cycle is repeated so often to find its steps: the middle one has both neighbours.
REPEATS = 3


def gaits_of(rig: Rig, takes: Sequence[tuple[str, Take]]) -> Gaits:
    """Return takes on a rig, by name, as gaits.

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
        idle.append(replace(slowest, turns=slowest.turns[:1], hips=slowest.hips[:1]))
    return Gaits(walker, tuple(moving), idle[0], tuple(reactions), tuple(notices))


# Above this Froude number's root people run.
RUNS = 0.7


def heading_of(turns: FloatArray) -> FloatArray:
    """Return how far turns ``(…, 4)`` go about y [rad]."""
    return np.asarray(2 * np.arctan2(turns[..., 1], turns[..., 3]))


def _gait(walker: Walker, name: str, take: Take) -> tuple[str, Gait]:
    """Return whether a take moves, stands or reacts, and it as a gait."""
    world = take.motion.world(walker.rig)
    hips = middle_of_hips(walker.person, world.positions)
    fps = float(take.clock.rate)
    way = np.linalg.norm((hips[-1] - hips[0])[[0, 2]])
    seconds = max(len(hips) - 1, 1) / fps
    try:
        found = find_cycle(take, shortest=SHORTEST, longest=LONGEST)
    except OptionError:
        found = None
    ranged = float(np.ptp(hips[:, [0, 2]], axis=0).max())
    if ranged < STANDS * walker.leg * min(seconds, 1.0):
        return "stands", _whole(walker, name, take, world)
    if found is None or found.share > SEAM or way < STANDS * walker.leg * seconds:
        return "reacts", _whole(walker, name, take, world)
    cycle = loop(take, found.first, found.last, repeats=REPEATS)
    gait = _cycle(walker, name, cycle)
    return (
        ("reacts", _whole(walker, name, take, world))
        if gait is None
        else ("moves", gait)
    )


@dataclass(frozen=True)
class _Body:
    """How a body goes: evenly along an arc, in the frames of a cycle.

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
        """Return where it looks ``(K,)`` [rad]."""
        return self.heading + self.turning * (frames - self.begin)

    def places(self, frames: FloatArray) -> FloatArray:
        """Return x and z ``(K, 2)`` [m]."""
        return (
            self.origin
            + _arc(self.heading, self.turning, frames - self.begin) @ self.velocity
        )

    @staticmethod
    def of(hips: FloatArray, headings: FloatArray, length: int) -> _Body:
        """Return that of the second cycle of three ``(3 L, …)``."""
        within = np.arange(length, 2 * length)
        turning = float(headings[2 * length] - headings[length]) / length
        heading = float((headings[within] - turning * (within - length)).mean())
        flat = hips[:, [0, 2]]
        whole = _arc(heading, turning, np.array([float(length)]))[0]
        velocity = np.linalg.solve(whole, flat[2 * length] - flat[length])
        body = _Body(length, length, np.zeros(2), heading, velocity, turning)
        off = flat[within] - body.places(within.astype(float))
        return replace(body, origin=off.mean(axis=0))


def _arc(heading: float, turning: float, t: FloatArray) -> FloatArray:
    """Return how velocities in a frame that turns add up ``(K, 2, 2)``, of x and z."""
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
    """Return the second of three cycles of a take; None where it is not two steps."""
    translations, turns, _ = take.motion.dense()
    world = forward(walker.rig, translations, turns)
    length, fps = take.clock.count // REPEATS, float(take.clock.rate)
    hips = middle_of_hips(walker.person, world.positions)
    body = _Body.of(hips, _headings(walker, world), length)
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
    origins = np.insert(body.places(frames), 1, ground, axis=1)
    local = _between(turns, frames)
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
class _Stance:
    """From when to when a foot stands [frames], and where it is flat."""

    lands: int
    lifts: int
    flat: BoolArray  # of all frames


def _stance(
    walker: Walker, world: WorldTransforms, k: int, length: int, fps: float
) -> _Stance | None:
    """Return the stance of a foot that begins in the second cycle, if it is one."""
    _, _, foot, toe = walker.legs[k]
    tip = None if toe < 0 else world.positions[:, toe]
    found: FootContacts = find_contacts(world.positions[:, foot], tip, fps, walker.leg)
    begun = [one for one in runs(found.any) if length <= one[0] < 2 * length]
    if len(begun) != 1 or not 0 < begun[0][1] - begun[0][0] < length:
        return None
    return _Stance(*begun[0], found.ankle & found.toe)


def _step(
    walker: Walker,
    world: WorldTransforms,
    body: _Body,
    ground: float,
    k: int,
    stance: _Stance,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return where a foot lands, its pitches, and its turns and lifts as it swings."""
    _, _, foot, toe = walker.legs[k]
    level, ball = walker.level[k], walker.ball[k]
    within = np.arange(stance.lands, stance.lifts)
    flat = within[stance.flat[within]] if stance.flat[within].any() else within
    soles = so3.multiply(world.rotations[:, foot], so3.conjugate(level))
    yaw = float(np.unwrap(heading_of(soles[flat])).mean())
    ends = world.positions[:, toe if toe >= 0 else foot]
    place = ends[within].mean(axis=0) - so3.rotate(about_up(np.array(yaw)), ball)
    place = place[[0, 2]]
    # As the body sees it: there it lands, and a cycle later again.
    land = np.array([float(stance.lands)])
    (here,), (look,) = body.places(land), body.headings(land)
    step = np.append(turned(place - here, -look), wrapped(yaw - look))
    (there,), (then,) = (
        body.places(land + body.length),
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
    places = place + moved[:, None] * (later[:2] - place)
    yaws = yaw + moved * (later[2] - yaw)
    back = about_up(-yaws)
    swings = so3.multiply(back, _between(soles, frames))
    ankles = rows(world.positions[:, foot], frames) - np.insert(
        places, 1, ground, axis=1
    )
    lifts = so3.rotate(back, ankles)
    # The ends of the swing are those of the stance.
    for end, fade in ((-1, 1 - shares), (0, shares)):
        at = 0 if end else -1
        stood = about_side(pitches[end : end + 1 or None])
        miss = so3.multiply(stood, so3.conjugate(swings[at : at + 1 or None]))
        swings = so3.multiply(so3.exp(fade[:, None] * so3.log(miss)), swings)
        lifts = lifts + fade[:, None] * (
            standing_ankle(walker, k, stood)[0] - lifts[at]
        )
    return step, pitches, swings, lifts


def _between(turns: FloatArray, frames: FloatArray) -> FloatArray:
    """Return turns ``(F, …, 4)`` between frames ``(K,)``."""
    made = rows(turns, frames)
    return np.asarray(made / np.linalg.norm(made, axis=-1, keepdims=True))


def _whole(walker: Walker, name: str, take: Take, world: WorldTransforms) -> Gait:
    """Return a take that is played as it is, about where its hips begin."""
    _, turns, _ = take.motion.dense()
    heading = _headings(walker, world)[0]
    back = about_up(np.array(-heading))
    hips = middle_of_hips(walker.person, world.positions)
    origin = np.array([hips[0, 0], _ground(walker, world), hips[0, 2]])
    root = so3.rotate(back, world.positions[:, 0] - origin)
    made = turns.copy()
    made[:, 0] = so3.multiply(back, turns[:, 0])
    seconds = max(take.clock.count - 1, 1) / float(take.clock.rate)
    return Gait(name, made, root, seconds, np.zeros(2), 0.0)


def _headings(walker: Walker, world: WorldTransforms) -> FloatArray:
    """Return where the hips look over time ``(F,)`` [rad]."""
    hips = max(walker.person.first("hips"), 0)
    rest = walker.person.rotations[hips]
    turned = so3.multiply(world.rotations[:, hips], so3.conjugate(rest))
    return np.unwrap(heading_of(turned)) + walker.ahead


def _ground(walker: Walker, world: WorldTransforms) -> float:
    """Return how high the ground is: below feet that stand [m]."""
    feet = [leg[2] for leg in walker.legs]
    heights = world.positions[:, feet, 1] - walker.ankle
    return float(np.quantile(heights.min(axis=1), 0.1))
