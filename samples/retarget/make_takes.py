"""Make ``takes/``, a dozen takes of a person of 1.74 m: what a day of capture brings.

Hips and feet come first. A foot that stands turns about its heel as it strikes, then
about its ball, and that point stays where it is; two-bone inverse kinematics puts the
legs between hips and feet. In steps, the flexion of the knee lifts the foot that
swings. Hips and feet of the walk and the run are such that knees follow those of gait
laboratories (Winter, 1991; Novacheck, 1998). Trunk and arms are angles over time.

Lengths are centimetres, angles degrees, time is seconds. Y is up, takes begin towards
+Z, the left is +X. Pitch is positive forwards and down: of a foot, the heel comes up.

Usage: ``python make_takes.py [FOLDER]``; FOLDER is ``takes`` beside this file unless
given.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

Array = NDArray[np.float64]
Figure = list[tuple[str, str, tuple[float, ...]]]  # name, parent, offset
Tracks = dict[str, Array]
Route = Callable[[Array], tuple[Array, Array, Array]]  # length: x, z, heading
Keys = Sequence[tuple[float, float]]

FPS = 30
GRAVITY = 981.0  # [cm/s²]
SIDES = {"l": 1.0, "r": -1.0}

SOCKET = np.array([9.0, -4.0, 0.0])  # left, from the hips
THIGH, SHIN = 42.0, 41.0
BALL = np.array([0.0, -6.0, 13.0])  # from the ankle
BALL_HEIGHT = 2.0
HEEL = np.array([0.0, -8.0, -5.0])  # from the ankle
STANDING = 94.3  # hips
HALF_GAP = 10.0  # ankle from the line of travel
EPSILON = 1e-6  # [cycles] for speeds

# Joint, its parent, its offset; the right side is mirrored.
TRUNK = [
    ("Hips", "", (0, 95, 0)),
    ("Spine", "Hips", (0, 10, 0)),
    ("Chest", "Spine", (0, 18, 0)),
    ("Neck", "Chest", (0, 24, 0)),
    ("Head", "Neck", (0, 9, 1)),
]
LIMBS = [
    ("Shoulder", "Chest", (3, 20, 0)),
    ("Arm", "Shoulder", (14, 0, 0)),
    ("ForeArm", "Arm", (28, 0, 0)),
    ("Hand", "ForeArm", (25, 0, 0)),
    ("UpLeg", "Hips", tuple(SOCKET)),
    ("Leg", "UpLeg", (0, -THIGH, 0)),
    ("Foot", "Leg", (0, -SHIN, 0)),
    ("ToeBase", "Foot", tuple(BALL)),
]
ENDS = {"Head": (0, 18, 0), "Hand": (16, 0, 0), "ToeBase": (0, -2, 7)}


def rotation(axis: int, angles: Array | float) -> Array:
    """Return rotations about an axis, 0 for X ``(..., 3, 3)``."""
    i, j = (axis + 1) % 3, (axis + 2) % 3
    radians = np.radians(np.asarray(angles, np.float64))
    matrices = np.zeros((*radians.shape, 3, 3))
    matrices[..., axis, axis] = 1.0
    matrices[..., i, i] = matrices[..., j, j] = np.cos(radians)
    matrices[..., j, i] = np.sin(radians)
    matrices[..., i, j] = -matrices[..., j, i]
    return matrices


def ease(share: Array) -> Array:
    """Return 0 to 1 with no speed and no acceleration at both ends."""
    s = np.clip(share, 0.0, 1.0)
    return np.asarray(s**3 * (10 - 15 * s + 6 * s * s))


def keyed(times: Array, keys: Keys) -> Array:
    """Return values that ease from key to key."""
    values = np.full(len(times), float(keys[0][1]))
    for (begin, low), (end, high) in pairwise(keys):
        values += (high - low) * ease((times - begin) / (end - begin))
    return values


def standing(seconds: float) -> tuple[Array, Tracks]:
    """Return times, and the tracks of who stands with hanging arms."""
    times = np.arange(round(seconds * FPS) + 1) / FPS
    names = "hips_x hips_z hips_yaw hips_pitch hips_roll bend twist lean nod look"
    tracks = {name: np.zeros(len(times)) for name in names.split()}
    tracks["hips_y"] = np.full(len(times), STANDING)
    for side, sign in SIDES.items():
        usual = {"ball_x": sign * HALF_GAP, "ball_y": BALL_HEIGHT, "ball_z": BALL[2]}
        usual |= {"foot_yaw": 0.0, "foot_pitch": 0.0, "toes": 1.0}
        usual |= {"lower": 74.0, "swing": 4.0, "roll": 0.0, "elbow": 14.0}
        for name, value in usual.items():
            tracks[f"{name}_{side}"] = np.full(len(times), value)
    return times, tracks


def straight(length: Array) -> tuple[Array, Array, Array]:
    """Return the path ahead."""
    return np.zeros_like(length), length, np.zeros_like(length)


def bent(start: float, radius: float) -> Route:
    """Return a path ahead that turns to the left by 180°, and comes back."""

    def path(length: Array) -> tuple[Array, Array, Array]:
        angle = np.clip((length - start) / radius, 0.0, np.pi)
        behind = np.maximum(length - start - np.pi * radius, 0.0)
        x = radius * (1 - np.cos(angle))
        z = np.minimum(length, start) + radius * np.sin(angle) - behind
        return x, z, np.degrees(angle)

    return path


@dataclass(frozen=True, slots=True)
class Step:
    """How a foot and the hips go in a cycle of two steps.

    Phases are shares of the cycle since the foot struck. Keys are at shares of the
    swing, from when the foot leaves the ground to when it strikes again.

    Attributes:
        stance: Phase in which the foot leaves the ground.
        flat: Phase from which its sole is down.
        rise: Phase in which its heel comes up.
        strike: Pitch of the foot as its heel strikes.
        leave: Pitch of the foot as its toes leave.
        ahead: Ball in front of the hips in the middle of the stance.
        height: Of the hips.
        bob: How far they go up and down.
        lowest: Phase in which they are lowest.
        skew: How much faster they rise than sink; less than 0 rises slower.
        knees: Flexion of the knee in the swing.
        pitches: Of the foot in the swing.
    """

    stance: float = 0.62
    flat: float = 0.075
    rise: float = 0.42
    strike: float = -16.0
    leave: float = 53.0
    ahead: float = 8.07
    height: float = 92.25
    bob: float = 2.05
    lowest: float = 0.031
    skew: float = 0.29
    knees: Keys = ((0.27, 64.0), (0.6, 34.0), (0.87, 8.5))
    pitches: Keys = ((0.2, 58.0), (0.5, 15.0), (0.8, -12.0))

    def hips(self, phase: Array) -> dict[str, Array]:
        """Return the tracks of the hips on a path straight ahead."""
        over = 4 * np.pi * (phase - self.lowest)
        skewed = self.skew * np.sin(over)
        return {
            "hips_x": 1.6 * np.sin(2 * np.pi * phase),
            "hips_y": self.height - self.bob * np.cos(over + skewed),
            "hips_yaw": -5 * np.cos(2 * np.pi * phase),
            "hips_pitch": np.zeros_like(phase),
            "hips_roll": 2.5 * np.sin(2 * np.pi * (phase - self.stance / 2 + 0.25)),
        }

    def stands(self, phase: Array) -> Array:
        """Return how the foot stands: its pitch, and its ankle from where its ball is.

        Returns:
            Pitch, way ahead and height above the ground ``(F, 3)``.
        """
        landing = np.clip(1 - phase / self.flat, 0.0, None)
        rising = np.clip((phase - self.rise) / (self.stance - self.rise), 0.0, None)
        pitch = self.strike * landing**2 + self.leave * rising**3
        foot = rotation(0, pitch)
        ball = np.array([0.0, BALL_HEIGHT, 0.0])
        on_heel = ball - BALL + HEEL - foot @ HEEL
        on_ball = ball - foot @ BALL
        ankle = np.where((phase < self.flat)[:, None], on_heel, on_ball)
        return np.column_stack([pitch, ankle[:, 2], ankle[:, 1]])

    def line(self, stride: float, phase: Array, ahead: Array) -> Array:
        """Return a left leg from the hip to the ankle; its height is that of the hip.

        Args:
            stride: Length of two steps.
            phase: Phases ``(F,)``.
            ahead: Ankle from where the ball stands ``(F,)``.

        Returns:
            Way across, height of the hip and way along ``(F, 3)``.
        """
        tracks = self.hips(phase)
        socket = pelvis(tracks) @ SOCKET
        swing = np.clip((phase - self.stance) / (1 - self.stance), 0.0, 1.0)
        ball = stride * (ease(swing) + self.stance / 2 - phase) + self.ahead
        return np.column_stack(
            [
                HALF_GAP - tracks["hips_x"] - socket[:, 0],
                tracks["hips_y"] + socket[:, 1],
                ball + ahead - socket[:, 2],
            ]
        )

    def flexion(self, stride: float, phase: Array) -> Array:
        """Return the flexion of the knee of a foot that stands ``(F,)``."""
        foot = self.stands(phase)
        line = self.line(stride, phase, foot[:, 1])
        line[:, 1] -= foot[:, 2]
        cosine = (line * line).sum(axis=1) - THIGH**2 - SHIN**2
        return np.degrees(np.arccos(cosine / (2 * THIGH * SHIN)))

    def foot(self, stride: float, phase: Array) -> Array:
        """Return what `stands` returns, of the whole cycle; the knee leads the swing.

        Raises:
            ValueError: A leg is too short.
        """
        ends = np.array([[self.stance - EPSILON, self.stance], [0.0, EPSILON]])
        first, last = (self.stands(pair) for pair in ends)
        knees = [self.flexion(stride, pair) for pair in ends]
        if not np.isfinite(knees).all():
            raise ValueError("the leg is too short where it strikes or leaves")
        curves = []
        for inner, begin, end in (
            (self.pitches, first[:, 0], last[:, 0]),
            ((), first[:, 1], last[:, 1]),
            (self.knees, *knees),
        ):
            shares = np.array([0.0, *(at for at, _ in inner), 1.0])
            times = self.stance + shares * (1 - self.stance)
            values = [begin[1], *(value for _, value in inner), end[0]]
            speeds = (1, np.diff(begin)[0] / EPSILON), (1, np.diff(end)[0] / EPSILON)
            curves.append(CubicSpline(times, values, bc_type=speeds))
        after = np.maximum(phase, self.stance)
        pitch, ahead, knee = (curve(after) for curve in curves)
        line = self.line(stride, after, ahead)
        reach = THIGH**2 + SHIN**2 + 2 * THIGH * SHIN * np.cos(np.radians(knee))
        height = line[:, 1] - np.sqrt(reach - line[:, 0] ** 2 - line[:, 2] ** 2)
        swing = np.column_stack([pitch, ahead, height])
        return np.where((phase < self.stance)[:, None], self.stands(phase), swing)


WALK = Step()
RUN = Step(
    stance=0.36,
    flat=0.05,
    rise=0.11,
    strike=-8.0,
    leave=43.8,
    ahead=-2.6,
    height=90.96,
    bob=3.5,
    lowest=0.221,
    skew=-0.05,
    knees=((0.38, 95.0), (0.7, 52.0), (0.92, 10.5)),
    pitches=((0.25, 70.0), (0.6, 20.0), (0.9, -12.0)),
)
SNEAK = Step(
    stance=0.6,
    rise=0.35,
    strike=0.0,
    leave=30.0,
    height=74.0,
    bob=1.0,
    skew=0.0,
    knees=((0.35, 108.0), (0.7, 90.0)),
    pitches=((0.3, 30.0), (0.7, 0.0)),
)
MARCH = Step(
    stance=0.55,
    flat=0.05,
    rise=0.377,
    strike=-7.7,
    leave=25.0,
    ahead=13.0,
    height=93.24,
    bob=1.2,
    lowest=0.028,
    skew=0.38,
    knees=((0.4, 112.0), (0.75, 60.0)),
    pitches=((0.2, 36.0), (0.45, 42.0), (0.75, 8.0)),
)
CARRY = Step(
    flat=0.067,
    rise=0.45,
    strike=-17.3,
    leave=31.3,
    ahead=11.32,
    height=92.83,
    bob=1.5,
    lowest=0.057,
    skew=0.395,
    pitches=((0.2, 44.0), (0.5, 16.0), (0.8, -13.0)),
)
TURN = Step(
    flat=0.06,
    rise=0.45,
    strike=-14.0,
    leave=27.0,
    ahead=12.6,
    height=91.6,
    bob=1.2,
    lowest=0.061,
    skew=0.4,
    knees=((0.27, 66.0), (0.55, 50.0), (0.87, 27.0)),
    pitches=((0.2, 40.0), (0.5, 8.0), (0.8, -11.0)),
)


def pelvis(tracks: Tracks) -> Array:
    """Return the rotations of the hips ``(F, 3, 3)``."""
    turned = rotation(1, tracks["hips_yaw"]) @ rotation(0, tracks["hips_pitch"])
    return np.asarray(turned @ rotation(2, tracks["hips_roll"]))


def gait(
    seconds: float,
    period: float,
    stride: float,
    step: Step = WALK,
    *,
    arms: float = 24.0,
    path: Route = straight,
    outer: float = 1.0,
) -> tuple[Array, Tracks]:
    """Return someone who goes along a path.

    Args:
        seconds: Of the take.
        period: Of two steps.
        stride: Length of two steps.
        step: How feet and hips go.
        arms: How far these swing.
        path: Where it leads.
        outer: Way of the right foot over that of the hips, where a path bends left.
    """
    times, tracks = standing(seconds)
    phase = times / period
    x, tracks["hips_z"], heading = path(stride * phase)
    own = step.hips(phase)
    tracks |= {name: own[name] for name in ("hips_y", "hips_roll")}
    tracks["hips_x"] = x + own["hips_x"] * np.cos(np.radians(heading))
    tracks["hips_yaw"] = heading + own["hips_yaw"]
    tracks["twist"] = 9 * np.cos(2 * np.pi * phase)
    tracks["bend"] = 3 + np.cos(4 * np.pi * phase)
    tracks["lean"] = -tracks["hips_roll"]
    tracks["look"] = -4 * np.cos(2 * np.pi * phase)
    for side, sign in SIDES.items():
        late = 0.0 if sign > 0 else 0.5
        count, since = np.floor(phase + late), (phase + late) % 1.0
        swing = np.clip((since - step.stance) / (1 - step.stance), 0.0, 1.0)
        place = count + ease(swing) + step.stance / 2 - late
        x, z, yaw = path(stride * place + step.ahead)
        far = 1.0 if sign > 0 else outer
        pitch, ahead, height = step.foot(far * stride, since).T
        ball = rotation(0, pitch) @ BALL + stacked(0 * ahead, height, ahead)
        # Where a path bends, both feet stay on their sides of it.
        across, along = np.cos(np.radians(yaw)), np.sin(np.radians(yaw))
        tracks[f"ball_x_{side}"] = x + sign * HALF_GAP * across + ball[:, 2] * along
        tracks[f"ball_y_{side}"] = ball[:, 1]
        tracks[f"ball_z_{side}"] = z - sign * HALF_GAP * along + ball[:, 2] * across
        tracks[f"foot_yaw_{side}"] = yaw
        tracks[f"foot_pitch_{side}"] = pitch
        # In the air toes go with the foot, but for a little.
        tracks[f"toes_{side}"] = 1 - 0.7 * ease(swing / 0.4)
        tracks[f"swing_{side}"] = 4 - sign * arms * np.cos(2 * np.pi * phase)
        tracks[f"elbow_{side}"] = 22 - sign * 0.4 * arms * np.cos(2 * np.pi * phase)
    return times, tracks


def walk() -> Tracks:
    """Return four steps ahead."""
    return gait(2.4, 1.1, 122.0)[1]


def run() -> Tracks:
    """Return a run: both feet leave the ground."""
    _, tracks = gait(2.0, 0.7, 166.0, RUN, arms=38)
    tracks["bend"] += 9
    for side in SIDES:
        tracks[f"elbow_{side}"] += 62
    return tracks


def sneak() -> Tracks:
    """Return low and slow steps, with hands before the chest."""
    _, tracks = gait(4.0, 2.0, 84.0, SNEAK, arms=8)
    tracks["bend"] += 30
    tracks["nod"] -= 28
    for side in SIDES:
        tracks[f"swing_{side}"] += 26
        tracks[f"elbow_{side}"] += 75
    return tracks


def march() -> Tracks:
    """Return steps with knees that come up high."""
    return gait(2.4, 1.2, 92.0, MARCH, arms=36)[1]


def turn() -> Tracks:
    """Return a walk that comes back in a half circle."""
    return gait(4.4, 1.1, 84.0, TURN, path=bent(80.0, 70.0), outer=80 / 70)[1]


def carry() -> Tracks:
    """Return a walk with a box in both hands."""
    _, tracks = gait(2.4, 1.2, 100.0, CARRY, arms=0)
    tracks["bend"] -= 9
    tracks["twist"] *= 0.3
    for side in SIDES:
        tracks[f"lower_{side}"] += 2
        tracks[f"swing_{side}"] += 16
        tracks[f"elbow_{side}"] += 62
    return tracks


def sidestep() -> Tracks:
    """Return two steps to the left and two back."""
    times, tracks = standing(4.0)
    plans = {
        "l": [(0.2, 0.7, 32), (1.2, 1.7, 32), (2.75, 3.2, -32), (3.5, 3.9, -32)],
        "r": [(0.75, 1.15, 32), (1.75, 2.15, 32), (2.25, 2.7, -32), (3.2, 3.5, -32)],
    }
    for side, steps in plans.items():
        for begin, end, way in steps:
            share = np.clip((times - begin) / (end - begin), 0.0, 1.0)
            tracks[f"ball_x_{side}"] += way * ease(share)
            tracks[f"ball_y_{side}"] += 7 * np.sin(np.pi * share) ** 2
        tracks[f"lower_{side}"] -= 12
        tracks[f"elbow_{side}"] += 20
    tracks["hips_x"] = (tracks["ball_x_l"] + tracks["ball_x_r"]) / 2
    tracks["hips_y"] -= 6
    return tracks


def sit() -> Tracks:
    """Return someone who sits down on a chair and gets up again."""
    times, tracks = standing(4.4)
    down = keyed(times, [(0.3, 0), (1.5, 1), (2.8, 1), (4.0, 0)])
    tipped = keyed(times, [(0.2, 0), (0.9, 1), (1.7, 0), (2.5, 0), (3.2, 1), (4.2, 0)])
    tracks["hips_y"] -= 41 * down
    tracks["hips_z"] -= 36 * down
    tracks["hips_pitch"] = 22 * tipped - 4 * down
    tracks["bend"] = 26 * tipped + 4 * down
    tracks["nod"] = -20 * tipped
    for side in SIDES:
        tracks[f"swing_{side}"] += 34 * down + 14 * tipped
        tracks[f"elbow_{side}"] += 40 * down
    return tracks


def wave() -> Tracks:
    """Return the right hand raised, and four waves of it."""
    times, tracks = standing(3.4)
    up = keyed(times, [(0.2, 0), (0.8, 1), (2.6, 1), (3.2, 0)])
    swing = np.sin(2 * np.pi * (times - 0.8) / 0.45) * up
    tracks["lower_r"] -= 86 * up
    tracks["lower_l"] += 3 * up
    tracks["elbow_l"] += 6 * up
    tracks["roll_r"] = 88 * up
    tracks["elbow_r"] += 70 * up + 20 * swing
    tracks["hips_x"] = 2.5 * up
    tracks["lean"] = 4 * up + swing
    tracks["look"] = -8 * up
    return tracks


def jump() -> Tracks:
    """Return a jump ahead from both feet."""
    times, tracks = standing(2.6)
    leave, air = 0.9, 0.4
    land = leave + air
    flight = np.clip(times - leave, 0.0, air)
    speed = GRAVITY * air / 2
    height = speed * flight - GRAVITY / 2 * flight**2
    crouch = keyed(times, [(0.1, 0), (0.6, 30)])
    thrust = np.clip((times - 0.6) / (leave - 0.6), 0.0, 1.0)
    # The hips leave the crouch at about the speed of the flight, and land with it.
    sinking = np.clip((times - land) / 0.6, 0.0, 1.0)
    caught = speed * 0.6 * sinking * (1 - sinking) ** 2
    low = crouch - 28 * thrust**2 + caught - keyed(times, [(land, 0), (2.4, 2)])
    tracks["hips_y"] += height - low
    share = flight / air
    tracks["hips_z"] = 8 * keyed(times, [(0.3, 0), (leave, 1)]) + 52 * share
    tracks["hips_z"] -= 8 * keyed(times, [(land, 0), (land + 0.5, 1)])
    low = keyed(
        times,
        [(0.1, 0), (0.6, 1), (leave, 0), (land - 0.1, 0), (land + 0.3, 0.9), (2.2, 0)],
    )
    tracks["hips_pitch"], tracks["bend"] = 14 * low, 22 * low
    tracks["nod"] = -16 * low
    lifted = keyed(times, [(leave - 0.25, 0), (leave, 1)])
    lowered = keyed(times, [(leave, 1), (land, 0)])
    for side in SIDES:
        tracks[f"ball_z_{side}"] += 52 * share
        tracks[f"ball_y_{side}"] += height + 6 * np.sin(np.pi * share) ** 2
        tracks[f"foot_pitch_{side}"] = 42 * lifted * lowered
        arms = keyed(
            times, [(0.1, 0), (0.6, -45), (leave, 75), (land + 0.3, 20), (2.2, 0)]
        )
        tracks[f"swing_{side}"] += arms
        tracks[f"elbow_{side}"] += 12 * low
    return tracks


def lift() -> Tracks:
    """Return a box picked up from the ground."""
    times, tracks = standing(3.6)
    down = keyed(times, [(0.2, 0), (1.4, 1), (1.8, 1), (3.2, 0)])
    held = keyed(times, [(1.5, 0), (2.8, 1)])
    tracks["hips_y"] -= 38 * down
    tracks["hips_z"] -= 16 * down
    tracks["hips_pitch"] = 34 * down
    tracks["bend"] = 44 * down - 5 * held
    tracks["nod"] = -24 * down
    for side in SIDES:
        tracks[f"lower_{side}"] += 4 * down
        tracks[f"swing_{side}"] += 62 * down + 18 * held * (1 - down)
        tracks[f"elbow_{side}"] += 66 * held * (1 - down)
    return tracks


def kick() -> Tracks:
    """Return a step, and a kick with the right foot."""
    times, tracks = standing(2.6)
    for name, keys in {
        "ball_z_r": [(0.4, 0), (0.85, -34), (1.15, 62), (1.3, 62), (2.0, 0)],
        "ball_y_r": [(0.4, 0), (0.8, 22), (0.95, 14), (1.15, 62), (1.3, 60), (2.0, 0)],
        "foot_pitch_r": [(0.4, 0), (0.85, 48), (1.15, 4), (2.0, 0)],
    }.items():
        tracks[name] += keyed(times, keys)
    tracks["foot_pitch_l"] += keyed(times, [(0.8, 0), (1.15, 12), (1.3, 12), (2.0, 0)])
    weight = keyed(times, [(0.05, 0), (0.4, 1), (2.0, 1), (2.5, 0)])
    swung = keyed(times, [(0.4, 0), (0.85, -1), (1.15, 1), (1.3, 1), (2.0, 0)])
    tracks["hips_x"] = 8 * weight
    tracks["hips_y"] -= 3 * weight
    tracks["hips_pitch"] = -6 * swung
    tracks["hips_yaw"] = 10 * swung
    tracks["twist"] = -14 * swung
    tracks["bend"] = 6 - 4 * swung
    for side, sign in SIDES.items():
        tracks[f"lower_{side}"] -= 26 * weight
        tracks[f"swing_{side}"] += sign * 26 * swung
        tracks[f"elbow_{side}"] += 20 * weight
    return tracks


TAKES = [walk, run, sneak, march, turn, carry, sidestep, sit, wave, jump, lift, kick]


def stacked(x: Array, y: Array, z: Array) -> Array:
    """Return points ``(F, 3)``."""
    return np.stack([x, y, z], axis=1)


def leg_rotations(
    tracks: Tracks, hips: Array, side: str
) -> tuple[Array, Array, Array, Array]:
    """Return local rotations of thigh, shin, foot and toes ``(F, 3, 3)`` each."""
    sign = SIDES[side]
    yaw, pitch = tracks[f"foot_yaw_{side}"], tracks[f"foot_pitch_{side}"]
    foot = rotation(1, yaw) @ rotation(0, pitch)
    ball = stacked(*(tracks[f"ball_{axis}_{side}"] for axis in "xyz"))
    ankle = ball - foot @ BALL
    socket = stacked(*(tracks[f"hips_{axis}"] for axis in "xyz"))
    socket += hips @ (SOCKET * [sign, 1, 1])
    way = ankle - socket
    reach = np.linalg.norm(way, axis=1)
    if reach.max() > 0.9995 * (THIGH + SHIN):
        raise ValueError(f"leg {side} is too short: {reach.max():.1f} cm")
    down = way / reach[:, None]
    # Knees point between where hips and foot do.
    ahead = hips[:, :, 2] + (rotation(1, yaw))[:, :, 2]
    hinge = np.cross(ahead, down)
    hinge /= np.linalg.norm(hinge, axis=1)[:, None]
    leg = np.stack([hinge, -down, np.cross(hinge, -down)], axis=2)
    at_hip = (THIGH**2 + reach**2 - SHIN**2) / (2 * THIGH * reach)
    at_knee = (THIGH**2 + SHIN**2 - reach**2) / (2 * THIGH * SHIN)
    thigh = leg @ rotation(0, -np.degrees(np.arccos(at_hip)))
    bend = rotation(0, 180 - np.degrees(np.arccos(at_knee)))
    local = hips.swapaxes(1, 2) @ thigh
    ankle_turn = (thigh @ bend).swapaxes(1, 2) @ foot
    # Toes stay on the ground as the heel comes up.
    toes = rotation(0, -np.clip(pitch, 0, 60) * tracks[f"toes_{side}"])
    return local, bend, ankle_turn, toes


def local_rotations(tracks: Tracks) -> dict[str, Array]:
    """Return the local rotations of each joint ``(F, 3, 3)``."""
    hips = pelvis(tracks)
    spine = rotation(1, tracks["twist"] / 2) @ rotation(0, tracks["bend"] / 2)
    spine = spine @ rotation(2, tracks["lean"] / 2)
    head = rotation(1, tracks["look"] / 2) @ rotation(0, tracks["nod"] / 2)
    turns = {"Hips": hips, "Spine": spine, "Chest": spine, "Neck": head, "Head": head}
    for side, sign in SIDES.items():
        name = "Left" if sign > 0 else "Right"
        arm = rotation(0, -tracks[f"swing_{side}"])
        arm = arm @ rotation(2, -sign * tracks[f"lower_{side}"])
        turns[f"{name}Arm"] = arm @ rotation(0, -tracks[f"roll_{side}"])
        turns[f"{name}ForeArm"] = rotation(1, -sign * tracks[f"elbow_{side}"])
        names = [f"{name}{joint}" for joint in ("UpLeg", "Leg", "Foot", "ToeBase")]
        turns |= zip(names, leg_rotations(tracks, hips, side), strict=True)
    return turns


def euler(matrices: Array) -> Array:
    """Return angles about Z, X and Y, in this order ``(F, 3)``."""
    x = np.arcsin(np.clip(matrices[:, 2, 1], -1, 1))
    z = np.arctan2(-matrices[:, 0, 1], matrices[:, 1, 1])
    y = np.arctan2(-matrices[:, 2, 0], matrices[:, 2, 2])
    return np.degrees(np.unwrap(np.stack([z, x, y], axis=1), axis=0))


def joints() -> Figure:
    """Return name, parent and offset of all joints."""
    figure = [(name, parent, offset) for name, parent, offset in TRUNK]
    for side, sign in (("Left", 1), ("Right", -1)):
        for name, parent, (x, y, z) in LIMBS:
            above = parent if parent in {"Chest", "Hips"} else side + parent
            figure.append((side + name, above, (sign * x, y, z)))
    return figure


def hierarchy(
    figure: Figure,
) -> tuple[str, list[str]]:
    """Return the first part of a BVH file, and the joints in its order."""
    order: list[str] = []

    def block(name: str, offset: tuple[float, ...], depth: int) -> str:
        order.append(name)
        pad, root = "  " * depth, not depth
        channels = "6 Xposition Yposition Zposition" if root else "3"
        text = f"{pad}{'ROOT' if root else 'JOINT'} {name}\n{pad}{{\n"
        text += f"{pad}  OFFSET {' '.join(f'{v:g}' for v in offset)}\n"
        text += f"{pad}  CHANNELS {channels} Zrotation Xrotation Yrotation\n"
        for child, parent, own in figure:
            if parent == name:
                text += block(child, own, depth + 1)
        side = -1 if name.startswith("Right") else 1
        end = ENDS.get(name.removeprefix("Left").removeprefix("Right"))
        if end:
            x, y, z = end
            text += f"{pad}  End Site\n{pad}  {{\n{pad}    OFFSET {side * x} {y} {z}\n"
            text += f"{pad}  }}\n"
        return text + f"{pad}}}\n"

    return "HIERARCHY\n" + block("Hips", figure[0][2], 0), order


def bvh(tracks: Tracks) -> str:
    """Return a take as BVH."""
    head, order = hierarchy(joints())
    turns = local_rotations(tracks)
    count = len(tracks["hips_x"])
    still = np.zeros((count, 3))
    columns = [stacked(*(tracks[f"hips_{axis}"] for axis in "xyz"))]
    columns += [euler(turns[name]) if name in turns else still for name in order]
    rows = np.round(np.concatenate(columns, axis=1), 3) + 0.0
    lines = [" ".join(f"{value:g}" for value in row) for row in rows]
    motion = [f"MOTION\nFrames: {count}\nFrame Time: {1 / FPS:.7f}", *lines, ""]
    return head + "\n".join(motion)


def main() -> None:
    """Write the takes."""
    parser = argparse.ArgumentParser(description="Make a dozen takes.")
    usual = Path(__file__).with_name("takes")
    parser.add_argument("folder", nargs="?", type=Path, default=usual)
    folder: Path = parser.parse_args().folder
    folder.mkdir(parents=True, exist_ok=True)
    for make in TAKES:
        path = folder / f"{make.__name__}.bvh"
        path.write_text(bvh(make()), "utf-8", newline="\n")


if __name__ == "__main__":
    main()
