"""Make ``walk.bvh``, a walk cycle designed from foot and pelvis paths.

The feet come first. A foot in stance turns about a point that rests on the floor,
so it cannot slide: about the heel after heel strike, about nothing while it is flat,
about the ball as the heel rises, about the toe tip as it pushes off. Splines that keep
position and speed carry it through swing. The pelvis travels over the feet, two-bone
inverse kinematics puts the legs between them, and the trunk and arms answer the pelvis.

Lengths are centimetres, angles degrees unless a name says radians, and time is phase:
cycles since the left heel struck, so the right foot is half a cycle behind. Y is up,
the walk goes towards +Z, and the left of the figure is +X. Turning about X by a
positive angle tips +Y towards +Z.

Usage: ``python make_walk.py [OUT]``; ``OUT`` is ``walk.bvh`` beside this file unless
given.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Curve = Callable[[Array], Array]

# Time and travel. 32 frames a cycle puts both heel strikes on a frame and gives 112
# steps a minute; 144 cm in 32/30 s is 1.35 m/s, an easy adult pace.
FPS = 30
FRAMES_PER_CYCLE = 32
CYCLES = 2
STRIDE = 144.0  # [cm] root travel in one cycle, two steps

# The figure, 1.75 m tall [cm]. The hip joints stand at 0.54 of it.
HIP_DROP = 6.0  # hip joints below the Hips joint
HIP_HALF_WIDTH = 9.0
THIGH = 44.0
SHANK = 42.5
ANKLE_HEIGHT = 8.0  # ankle above the sole
HEEL_BACK = 5.5  # heel behind the ankle
BALL_FORWARD = 13.0  # toe joint in front of the ankle
BALL_HEIGHT = 2.5  # toe joint above the sole
TOE_LENGTH = 7.0  # toe tip in front of the toe joint

# Points of a foot: the heel seen from the ankle, the ball seen from the ankle, and the
# tip of the sole seen from the ball.
HEEL = np.array([0.0, -ANKLE_HEIGHT, -HEEL_BACK])
BALL = np.array([0.0, BALL_HEIGHT - ANKLE_HEIGHT, BALL_FORWARD])
TIP = np.array([0.0, -BALL_HEIGHT, TOE_LENGTH])

# A foot's cycle, as phase since its own heel strike.
FOOT_FLAT = 0.071  # the sole is down
HEEL_OFF = 0.358  # the heel rises, the toes stay down
TOES_ROLL = 0.498  # the ball rises too, the toe tip stays down
TOE_OFF = 0.62  # the toe tip leaves the floor

# The foot's shape at those moments [deg], toes up positive.
STRIKE_PITCH = 20.5
TOE_OFF_PITCH = -66.2
TOE_OFF_TOE_PITCH = -23.4  # toes against the floor, so they bend 39 deg at the ball

# Swing: values at fractions of the time from toe off to the next heel strike. The foot
# trails toes down, passes level, and reaches with its toes up; the ball passes lowest
# at mid swing, where walkers trip.
PITCH_KEYS = ((0.18, -69.9), (0.50, -13.5), (0.80, 12.6))  # [deg]
TOE_PITCH_KEYS = ((0.16, -32.6), (0.50, -7.4), (0.80, 21.7))  # [deg]
BALL_HEIGHT_KEYS = ((0.20, 10.6), (0.48, 5.3), (0.80, 10.6))  # [cm]
BALL_TRAVEL_KEYS = ((0.25, 0.20), (0.50, 0.58), (0.75, 0.92))  # share of the way

# Footprints.
STRIKE_AHEAD = 34.8  # [cm] flat ankle in front of the pelvis at heel strike
FOOT_HALF_GAP = 5.0  # [cm] ankle from the line of travel
TOE_OUT = 7.0  # [deg]
KNEE_OUT = 4.0  # [deg] the knee points between the hip's and the foot's heading

# The pelvis. Everything here swings once or twice a cycle; amplitudes are half ranges.
PELVIS_HEIGHT = 97.3  # [cm] mean; low enough that no knee locks
PELVIS_BOB = 2.1  # [cm] lowest just after heel strike, highest at mid stance
PELVIS_SKEW = 0.23  # [rad] it rises faster than it sinks
PELVIS_SURGE = 0.9  # [cm] fastest where lowest, as a pendulum
PELVIS_SWAY = 2.0  # [cm] towards the leg that carries
PELVIS_TURN = 5.0  # [deg] the striking leg's side leads
PELVIS_LIST = 4.0  # [deg] the free leg's side drops
PELVIS_TILT = (3.0, 1.0)  # [deg] forward lean, mean and half range
LOW_PHASE = 0.022
LIST_PHASE = 0.13  # of the left leg's loading
SWAY_PHASE = 0.31

# The trunk, in the world. The chest turns against the pelvis, the head hardly at all.
CHEST_TURN = 7.0  # [deg]
CHEST_LIST = 1.5  # [deg] against the pelvis
CHEST_LEAN = (4.0, 0.8)  # [deg] forward lean, mean and half range
HEAD_TURN = 0.8  # [deg]
HEAD_NOD = (2.0, 1.0)  # [deg] down as the body rises, so that the gaze holds

# The arms. The left arm is foremost just after the right heel strikes; the elbow and
# the hand lag, as links of a pendulum do.
ARM_HANG = 81.0  # [deg] below the T pose
ARM_SWING = (-4.0, 21.0)  # [deg] forward of straight down, mean and half range
ARM_INWARD = 12.0  # [deg] the swing's plane turns inward in front
ELBOW_BEND = (23.0, 10.0)  # [deg] mean and half range
HAND_BEND = (5.0, 4.0)  # [deg] mean and half range
SHOULDER_SWING = 3.0  # [deg] the shoulder follows its arm
ARM_PHASE = 0.52
ELBOW_LAG = 0.05
HAND_LAG = 0.10

SPEED_STEP = 1e-5  # [cycles] for one-sided differences
SIDES = {"Left": 1.0, "Right": -1.0}


@dataclass(frozen=True, slots=True)
class Joint:
    """A joint of the figure in its T pose.

    Attributes:
        name: Name in the file.
        parent: Name of its parent, or None for the root.
        offset: Place as seen from the parent [cm].
        tip: Place of its end site as seen from the joint [cm], for a leaf.
    """

    name: str
    parent: str | None
    offset: tuple[float, ...]
    tip: tuple[float, ...] | None = None


@dataclass(frozen=True, slots=True)
class Foot:
    """One foot in the world, over the frames.

    Attributes:
        ankle: Ankle positions ``(F, 3)`` [cm].
        turn: Orientations of the foot ``(F, 3, 3)``.
        toe_turn: Orientations of the toes ``(F, 3, 3)``.
    """

    ankle: Array
    turn: Array
    toe_turn: Array


def joints() -> list[Joint]:
    """Return the figure's joints, parents first, in the order of the file."""
    # The root's offset is zero because readers differ on whether its position
    # channels replace the offset or add to it.
    figure = [
        Joint("Hips", None, (0.0, 0.0, 0.0)),
        Joint("Spine", "Hips", (0.0, 9.0, -1.0)),
        Joint("Chest", "Spine", (0.0, 15.0, 0.0)),
        Joint("Neck", "Chest", (0.0, 26.0, 0.0)),
        Joint("Head", "Neck", (0.0, 9.0, 1.5), tip=(0.0, 15.5, 0.0)),
    ]
    for side, sign in SIDES.items():
        figure += [
            Joint(f"{side}Shoulder", "Chest", (sign * 3.0, 21.0, 0.0)),
            Joint(f"{side}Arm", f"{side}Shoulder", (sign * 15.0, 0.0, 0.0)),
            Joint(f"{side}ForeArm", f"{side}Arm", (sign * 29.0, 0.0, 0.0)),
            Joint(
                f"{side}Hand",
                f"{side}ForeArm",
                (sign * 25.5, 0.0, 0.0),
                tip=(sign * 17.5, 0.0, 0.0),
            ),
        ]
    for side, sign in SIDES.items():
        figure += [
            Joint(f"{side}UpLeg", "Hips", (sign * HIP_HALF_WIDTH, -HIP_DROP, 0.0)),
            Joint(f"{side}Leg", f"{side}UpLeg", (0.0, -THIGH, 0.0)),
            Joint(f"{side}Foot", f"{side}Leg", (0.0, -SHANK, 0.0)),
            Joint(f"{side}Toe", f"{side}Foot", tuple(BALL), tip=tuple(TIP)),
        ]
    return figure


def rotation(axis: str, degrees: Array | float) -> Array:
    """Return rotations about the X, Y or Z axis ``(..., 3, 3)``."""
    radians = np.radians(np.asarray(degrees, dtype=np.float64))
    first = "XYZ".index(axis)
    i, j = (first + 1) % 3, (first + 2) % 3
    turn = np.zeros((*radians.shape, 3, 3))
    turn[..., first, first] = 1.0
    turn[..., i, i] = turn[..., j, j] = np.cos(radians)
    turn[..., j, i] = np.sin(radians)
    turn[..., i, j] = -turn[..., j, i]
    return turn


def apply(turn: Array, vector: Array) -> Array:
    """Return vectors ``(..., 3)`` turned by rotations ``(..., 3, 3)``."""
    turned: Array = (turn @ vector[..., None])[..., 0]
    return turned


def heading(sign: float) -> Array:
    """Return the turn of a flat foot ``(3, 3)``, toes out."""
    return rotation("Y", sign * TOE_OUT)


def pitched(degrees: Array) -> Array:
    """Return turns that bring the toes up ``(..., 3, 3)``."""
    return rotation("X", -degrees)


def posed(turn: Array, lean: Array, roll: Array) -> Array:
    """Return world turns from degrees to the left, forward, and left side up."""
    return rotation("Y", turn) @ rotation("X", lean) @ rotation("Z", roll)


def aimed(up: Array, hinge: Array) -> Array:
    """Return turns with Y along ``up`` and X along ``hinge``, unit and square."""
    return np.stack([hinge, up, np.cross(hinge, up)], axis=-1)


def halfway(one: Array, other: Array) -> Array:
    """Return the turns midway between two that are near each other.

    The sum of two rotations a turn of t apart about one axis is twice the midway
    rotation, shortened by cos(t/2) across that axis; the polar factor undoes that.
    """
    u, _, vt = np.linalg.svd(one + other)
    middle: Array = u @ vt
    return middle


def relative(parent: Array, child: Array) -> Array:
    """Return ``child``'s orientations as seen from ``parent`` ``(..., 3, 3)``."""
    return np.swapaxes(parent, -1, -2) @ child


def wave(phase: Array, peak: float, per_cycle: int = 1) -> Array:
    """Return a cosine in [-1, 1] that peaks at ``peak``, ``per_cycle`` a cycle."""
    return np.cos(2.0 * np.pi * per_cycle * (phase - peak))


def swing_of(mean_and_half_range: tuple[float, float], unit: Array) -> Array:
    """Return ``unit``, in [-1, 1], scaled to a mean and a half range."""
    mean, half_range = mean_and_half_range
    return mean + half_range * unit


def clamped_spline(
    keys: Sequence[tuple[float, float]], start_speed: float, end_speed: float
) -> Curve:
    """Return the cubic spline through ``keys`` with given speeds at both ends.

    Args:
        keys: Ascending times and the values there.
        start_speed: Derivative at the first key.
        end_speed: Derivative at the last key.

    Returns:
        A function of times ``(N,)``, with two continuous derivatives.
    """
    knots, values = np.array(keys, dtype=np.float64).T
    width = np.diff(knots)
    slope = np.diff(values) / width
    # Speeds at the inner knots are those that make the second derivative continuous.
    system = np.eye(len(knots))
    right = np.empty(len(knots))
    right[0], right[-1] = start_speed, end_speed
    for k in range(1, len(knots) - 1):
        before, after = width[k - 1], width[k]
        system[k, k - 1 : k + 2] = after, 2.0 * (before + after), before
        right[k] = 3.0 * (after * slope[k - 1] + before * slope[k])
    speed = np.linalg.solve(system, right)

    def curve(time: Array) -> Array:
        k = np.clip(np.searchsorted(knots, time, "right") - 1, 0, len(width) - 1)
        s = (time - knots[k]) / width[k]
        r = 1.0 - s
        line = r * values[k] + s * values[k + 1]
        drift = r * (speed[k] - slope[k]) - s * (speed[k + 1] - slope[k])
        value: Array = line + width[k] * s * r * drift
        return value

    return curve


def stance_foot(phase: Array, sign: float) -> Array:
    """Return a foot in stance, seen from the floor under its flat ankle.

    Args:
        phase: Phases since the foot's heel strike, from 0 to ``TOE_OFF`` ``(N,)``.
        sign: 1 for the left foot, -1 for the right.

    Returns:
        Pitch of the foot [deg], pitch of the toes [deg], and the ball's place along
        X, Y and Z [cm] ``(N, 5)``.
    """
    landing = np.clip(1.0 - phase / FOOT_FLAT, 0.0, None)
    rising = np.clip((phase - HEEL_OFF) / (TOE_OFF - HEEL_OFF), 0.0, None)
    rolling = np.clip((phase - TOES_ROLL) / (TOE_OFF - TOES_ROLL), 0.0, None)
    pitch = STRIKE_PITCH * landing**2 + TOE_OFF_PITCH * rising**3
    toe_pitch = STRIKE_PITCH * landing**2 + TOE_OFF_TOE_PITCH * rolling**2

    # What rests on the floor stays where the flat foot puts it: the heel, then the tip.
    flat_ankle = np.array([0.0, ANKLE_HEIGHT, 0.0])
    from_heel = flat_ankle + HEEL + apply(pitched(pitch), BALL - HEEL)
    from_tip = flat_ankle + BALL + TIP - apply(pitched(toe_pitch), TIP)
    ball = np.where((phase < FOOT_FLAT)[:, None], from_heel, from_tip)
    return np.column_stack([pitch, toe_pitch, apply(heading(sign), ball)])


def swing_foot(sign: float) -> Curve:
    """Return the function that carries a foot from toe off to the next heel strike.

    It takes phases from ``TOE_OFF`` to 1 and returns what `stance_foot` returns.
    """
    start, before = stance_foot(np.array([TOE_OFF, TOE_OFF - SPEED_STEP]), sign)
    end, after = stance_foot(np.array([0.0, SPEED_STEP]), sign)
    start_speed = (start - before) / SPEED_STEP
    end_speed = (after - end) / SPEED_STEP
    end[4] += STRIDE

    way = end[4] - start[4]
    travel_keys = [(at, start[4] + share * way) for at, share in BALL_TRAVEL_KEYS]
    columns = (PITCH_KEYS, TOE_PITCH_KEYS, (), BALL_HEIGHT_KEYS, travel_keys)
    curves = []
    for column, keys in enumerate(columns):
        inner = [(TOE_OFF + at * (1.0 - TOE_OFF), value) for at, value in keys]
        knots = [(TOE_OFF, start[column]), *inner, (1.0, end[column])]
        curves.append(clamped_spline(knots, start_speed[column], end_speed[column]))
    return lambda phase: np.column_stack([curve(phase) for curve in curves])


def foot_path(phase: Array, sign: float) -> Foot:
    """Return a foot over the frames.

    Args:
        phase: Phases of the walk ``(F,)``.
        sign: 1 for the left foot, -1 for the right.
    """
    late = 0.0 if sign > 0 else 0.5
    cycle = np.floor(phase - late)
    own = phase - late - cycle
    planted = own <= TOE_OFF
    shape = np.empty((len(phase), 5))
    shape[planted] = stance_foot(own[planted], sign)
    shape[~planted] = swing_foot(sign)(own[~planted])

    turn = heading(sign) @ pitched(shape[:, 0])
    toe_turn = heading(sign) @ pitched(shape[:, 1])
    ball = shape[:, 2:]
    ball[:, 0] += sign * FOOT_HALF_GAP
    ball[:, 2] += (cycle + late) * STRIDE + STRIKE_AHEAD
    return Foot(ball - apply(turn, BALL), turn, toe_turn)


def pelvis_path(phase: Array) -> tuple[Array, Array]:
    """Return the pelvis over the frames: positions ``(F, 3)`` and turns ``(F, 3, 3)``.

    The left heel strikes at phase 0 and the left leg carries until past the half.
    """
    over = 4.0 * np.pi * (phase - LOW_PHASE)
    surge = wave(phase, LOW_PHASE + 0.125, 2)  # a quarter wave behind the speed
    position = np.column_stack(
        [
            PELVIS_SWAY * wave(phase, SWAY_PHASE),
            PELVIS_HEIGHT - PELVIS_BOB * np.cos(over + PELVIS_SKEW * np.sin(over)),
            STRIDE * phase + PELVIS_SURGE * surge,
        ]
    )
    turn = posed(
        turn=-PELVIS_TURN * wave(phase, 0.0),
        lean=swing_of(PELVIS_TILT, wave(phase, LOW_PHASE, 2)),
        roll=PELVIS_LIST * wave(phase, LIST_PHASE),
    )
    return position, turn


def pose_trunk(phase: Array, pelvis: Array) -> dict[str, Array]:
    """Return the turns of the pelvis, trunk and head in the world."""
    chest = posed(
        turn=CHEST_TURN * wave(phase, 0.0),
        lean=swing_of(CHEST_LEAN, wave(phase, LOW_PHASE, 2)),
        roll=-CHEST_LIST * wave(phase, LIST_PHASE),
    )
    head = posed(
        turn=HEAD_TURN * wave(phase, 0.0),
        lean=swing_of(HEAD_NOD, -wave(phase, LOW_PHASE, 2)),
        roll=np.zeros_like(phase),
    )
    return {
        "Hips": pelvis,
        "Spine": halfway(pelvis, chest),
        "Chest": chest,
        "Neck": halfway(chest, head),
        "Head": head,
    }


def pose_arm(phase: Array, side: str) -> dict[str, Array]:
    """Return an arm's turns, each as seen from its parent."""
    sign = SIDES[side]
    peak = ARM_PHASE if sign > 0 else ARM_PHASE - 0.5
    forward = wave(phase, peak)
    arm = (
        rotation("Y", -sign * ARM_INWARD)
        @ rotation("X", -swing_of(ARM_SWING, forward))
        @ rotation("Z", -sign * ARM_HANG)
    )
    elbow = swing_of(ELBOW_BEND, wave(phase, peak + ELBOW_LAG))
    hand = swing_of(HAND_BEND, wave(phase, peak + HAND_LAG))
    return {
        f"{side}Shoulder": rotation("Y", -sign * SHOULDER_SWING * forward),
        f"{side}Arm": arm,
        f"{side}ForeArm": rotation("Y", -sign * elbow),
        f"{side}Hand": rotation("Y", -sign * hand),
    }


def pose_leg(side: str, position: Array, pelvis: Array, foot: Foot) -> dict[str, Array]:
    """Return a leg's turns in the world: two-bone inverse kinematics.

    Args:
        side: ``Left`` or ``Right``.
        position: Pelvis positions ``(F, 3)`` [cm].
        pelvis: Pelvis turns ``(F, 3, 3)``.
        foot: Where the foot is.

    Raises:
        ValueError: The leg is too short for the path of the foot.
    """
    sign = SIDES[side]
    socket = np.array([sign * HIP_HALF_WIDTH, -HIP_DROP, 0.0])
    line = foot.ankle - position - apply(pelvis, socket)
    length = np.linalg.norm(line, axis=-1, keepdims=True)
    if length.max() >= THIGH + SHANK:
        raise ValueError(f"{side} leg: {length.max():.2f} cm is out of reach")
    down = line / length
    ahead = rotation("Y", sign * KNEE_OUT)[:, 2]
    ahead = ahead - (down @ ahead)[:, None] * down
    ahead /= np.linalg.norm(ahead, axis=-1, keepdims=True)

    # The knee, by the law of cosines: so far down the line, so far ahead of it.
    along = (length**2 + THIGH**2 - SHANK**2) / (2.0 * length)
    out = np.sqrt(THIGH**2 - along**2)
    knee = along * down + out * ahead
    hinge = np.cross(ahead, down)
    return {
        f"{side}UpLeg": aimed(-knee / THIGH, hinge),
        f"{side}Leg": aimed((knee - line) / SHANK, hinge),
        f"{side}Foot": foot.turn,
        f"{side}Toe": foot.toe_turn,
    }


def walk(phase: Array) -> tuple[Array, dict[str, Array]]:
    """Return the walk: root positions ``(F, 3)`` and every joint's local turns."""
    position, pelvis = pelvis_path(phase)
    world = pose_trunk(phase, pelvis)
    local: dict[str, Array] = {}
    for side, sign in SIDES.items():
        world |= pose_leg(side, position, pelvis, foot_path(phase, sign))
        local |= pose_arm(phase, side)
    for joint in joints():
        if joint.name not in local:
            parent = world[joint.parent] if joint.parent else np.eye(3)
            local[joint.name] = relative(parent, world[joint.name])
    return position, local


def zxy_angles(turn: Array) -> Array:
    """Return the angles [deg] about Z, X and Y whose product in order is ``turn``."""
    z = np.arctan2(-turn[..., 0, 1], turn[..., 1, 1])
    x = np.arcsin(np.clip(turn[..., 2, 1], -1.0, 1.0))
    y = np.arctan2(-turn[..., 2, 0], turn[..., 2, 2])
    angles: Array = np.degrees(np.stack([z, x, y], axis=-1))
    return angles


def decimals(values: Sequence[float] | Array, places: int) -> str:
    """Return numbers separated by blanks, without trailing or negative zeros."""
    # Adding zero turns -0.0 into 0.0.
    return " ".join(f"{round(float(v), places) + 0.0:.{places}f}" for v in values)


def hierarchy(figure: Sequence[Joint], joint: Joint, depth: int = 0) -> list[str]:
    """Return the lines of ``joint`` and what hangs on it."""
    tab = "\t" * depth
    channels = "Zrotation Xrotation Yrotation"
    if joint.parent is None:
        channels = f"6 Xposition Yposition Zposition {channels}"
    else:
        channels = f"3 {channels}"
    lines = [
        f"{tab}{'JOINT' if joint.parent else 'ROOT'} {joint.name}",
        f"{tab}{{",
        f"{tab}\tOFFSET {decimals(joint.offset, 4)}",
        f"{tab}\tCHANNELS {channels}",
    ]
    for child in figure:
        if child.parent == joint.name:
            lines += hierarchy(figure, child, depth + 1)
    if joint.tip is not None:
        lines += [
            f"{tab}\tEnd Site",
            f"{tab}\t{{",
            f"{tab}\t\tOFFSET {decimals(joint.tip, 4)}",
            f"{tab}\t}}",
        ]
    return [*lines, f"{tab}}}"]


def bvh_text(position: Array, local: dict[str, Array]) -> str:
    """Return the walk as the text of a BVH file."""
    figure = joints()
    lines = hierarchy(figure, figure[0])
    order = [line.split()[1] for line in lines if line.split()[0] in ("ROOT", "JOINT")]
    angles = np.concatenate([zxy_angles(local[name]) for name in order], axis=1)
    rows = [
        f"{decimals(place, 4)} {decimals(row, 5)}"
        for place, row in zip(position, angles, strict=True)
    ]
    motion = ["MOTION", f"Frames: {len(rows)}", f"Frame Time: {1.0 / FPS:.7f}"]
    return "\n".join(["HIERARCHY", *lines, *motion, *rows, ""])


def main() -> None:
    """Write the walk to the file named on the command line."""
    parser = argparse.ArgumentParser(description="Make walk.bvh, a walk cycle.")
    parser.add_argument(
        "out", nargs="?", type=Path, default=Path(__file__).with_name("walk.bvh")
    )
    out: Path = parser.parse_args().out
    # The frame after the last would be the first one again, further on.
    frames = np.arange(CYCLES * FRAMES_PER_CYCLE, dtype=np.float64)
    text = bvh_text(*walk(frames / FRAMES_PER_CYCLE))
    out.write_text(text, encoding="ascii", newline="\n")
    print(f"{out}: {len(frames)} frames, {len(joints())} joints")


if __name__ == "__main__":
    main()
