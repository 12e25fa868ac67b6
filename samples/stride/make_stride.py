"""Make ``stride.clip.yaml``, one walk cycle of the biped from foot and pelvis paths.

The feet come first. In stance a foot turns about a point that rests on the floor: the
heel after it strikes, nothing while it is flat, the ball as the heel rises. Splines
carry it through swing. Two-bone inverse kinematics puts the legs between the feet and
the hips. Every frame gets a key with the exact velocity of the pose, so that the curves
between the keys leave the floor by far less than the eye sees.

Lengths are metres, angles radians unless a name says degrees, time is phase: cycles
since the left heel struck. Y is up, the walk goes towards +Z, left is +X. Positive
pitch brings the toes up.

Usage: ``python make_stride.py [OUT]``; ``OUT`` is ``stride.clip.yaml`` beside this file
unless given.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Curve = Callable[[float], float]

FRAMES = 24  # a cycle
STRIDE = 1.30  # [m] travel in one cycle, two steps

# The biped's leg, from its rig.
REST = np.array([0.0, 0.96, 0.0])
SOCKET = np.array([0.09, -0.06, 0.0])  # left; the right one mirrors
THIGH = np.array([0.0, -0.42, 0.01])
SHANK = np.array([0.0, -0.40, -0.02])
BALL = np.array([0.0, -0.06, 0.13])
HEEL = np.array([0.0, -0.08, -0.05])  # seen from the ankle
ANKLE_HEIGHT = 0.08
BALL_HEIGHT = 0.02

# A foot's cycle, as phase since its heel struck: frames 1, 3, 10, 16 of 24.
FLAT, HEEL_OFF, TOE_OFF = 2 / FRAMES, 9 / FRAMES, 15 / FRAMES
STRIKE_PITCH, TOE_OFF_PITCH = 22.4, -60.0  # [deg]
AHEAD = 0.335  # [m] flat ankle in front of the hips at heel strike
HALF_GAP = 0.07  # [m] ankle from the line of travel
# In swing, at fractions of the time from toe off to strike.
PITCH_KEYS = ((0.25, -52.8), (0.55, -12.5), (0.82, 14.1))  # [deg]
TOE_KEYS = ((0.12, -20.0), (0.3, -17.0), (0.55, 1.2), (0.82, 19.8))  # [deg] of the toes
HEIGHT_KEYS = ((0.25, 0.102), (0.5, 0.04), (0.8, 0.098))  # [m] of the ball
TRAVEL_KEYS = ((0.25, 0.202), (0.5, 0.525), (0.75, 0.921))  # share of the way

HIPS_HEIGHT, BOB, SWAY = 0.93, 0.02, 0.018  # [m]
LOWEST = 0.033  # phase
SKEW = 0.22  # [rad] hips rise faster than they sink
HIPS_TURN, HIPS_LIST = 5.0, 3.0  # [deg]


def turn(axis: int, angle: float) -> Array:
    """Return the rotation about an axis, 0 for X ``(3, 3)``."""
    i, j = (axis + 1) % 3, (axis + 2) % 3
    made = np.eye(3)
    made[i, i] = made[j, j] = np.cos(angle)
    made[j, i] = np.sin(angle)
    made[i, j] = -made[j, i]
    return made


def wave(phase: float, peak: float, per_cycle: int = 1) -> float:
    """Return a cosine that peaks at a phase."""
    return float(np.cos(2 * np.pi * per_cycle * (phase - peak)))


def spline(keys: Sequence[tuple[float, float]], first: float, last: float) -> Curve:
    """Return the cubic spline through keys, with its speeds at both ends."""
    knots, values = np.array(keys, dtype=np.float64).T
    width = np.diff(knots)
    slope = np.diff(values) / width
    system, right = np.eye(len(knots)), np.zeros(len(knots))
    right[0], right[-1] = first, last
    for k in range(1, len(knots) - 1):
        before, after = width[k - 1], width[k]
        system[k, k - 1 : k + 2] = after, 2 * (before + after), before
        right[k] = 3 * (after * slope[k - 1] + before * slope[k])
    speed = np.linalg.solve(system, right)

    def curve(time: float) -> float:
        k = int(np.clip(np.searchsorted(knots, time, "right") - 1, 0, len(width) - 1))
        s = (time - knots[k]) / width[k]
        drift = (1 - s) * (speed[k] - slope[k]) - s * (speed[k + 1] - slope[k])
        line = (1 - s) * values[k] + s * values[k + 1]
        return float(line + width[k] * s * (1 - s) * drift)

    return curve


def stance(phase: float) -> Array:
    """Return pitch of foot and toes [deg], height and place of the ball [m]."""
    landing = max(1 - phase / FLAT, 0.0)
    rising = max((phase - HEEL_OFF) / (TOE_OFF - HEEL_OFF), 0.0)
    pitch = STRIKE_PITCH * landing**2 + TOE_OFF_PITCH * rising**3
    ball = np.array([0.0, BALL_HEIGHT, BALL[2]])
    if landing > 0:
        flat_heel = np.array([0.0, ANKLE_HEIGHT, 0.0]) + HEEL
        ball = flat_heel + turn(0, -np.radians(pitch)) @ (BALL - HEEL)
    return np.array([pitch, STRIKE_PITCH * landing**2, ball[1], ball[2]])


def swing() -> list[Curve]:
    """Return what `stance` returns as curves from toe off to the next strike."""
    step = 1e-6
    start, end = stance(TOE_OFF), stance(0.0)
    leave = (start - stance(TOE_OFF - step)) / step
    meet = (stance(step) - end) / step
    end[3] += STRIDE
    way = end[3] - start[3]
    travel = tuple((at, start[3] + share * way) for at, share in TRAVEL_KEYS)
    curves = []
    for i, keys in enumerate((PITCH_KEYS, TOE_KEYS, HEIGHT_KEYS, travel)):
        inner = [(TOE_OFF + at * (1 - TOE_OFF), value) for at, value in keys]
        knots = [(TOE_OFF, start[i]), *inner, (1.0, end[i])]
        curves.append(spline(knots, leave[i], meet[i]))
    return curves


SWING = swing()


def hips(phase: float) -> tuple[Array, Array]:
    """Return place and Euler XYZ angles of the hips."""
    over = 4 * np.pi * (phase - LOWEST)
    place = np.array(
        [
            SWAY * wave(phase, 0.31),
            HIPS_HEIGHT - BOB * np.cos(over + SKEW * np.sin(over)),
            STRIDE * phase,
        ]
    )
    angles = [2.0, -HIPS_TURN * wave(phase, 0.0), HIPS_LIST * wave(phase, 0.15)]
    return place, np.radians(angles)


def euler_xyz(made: Array) -> Array:
    """Return the angles of ``Rx · Ry · Rz``."""
    return np.array(
        [
            np.arctan2(-made[1, 2], made[2, 2]),
            np.arcsin(made[0, 2]),
            np.arctan2(-made[0, 1], made[0, 0]),
        ]
    )


def leg(phase: float, sign: float) -> dict[str, Array]:
    """Return the angles of a leg: hip, knee, ankle, toe.

    Raises:
        ValueError: The leg is too short.
    """
    late = 0.0 if sign > 0 else 0.5
    cycle = np.floor(phase - late)
    own = phase - late - cycle
    shape = stance(own) if own <= TOE_OFF else np.array([c(own) for c in SWING])
    foot = turn(0, -np.radians(shape[0]))
    ball = np.array([0.0, shape[2], shape[3] + (cycle + late) * STRIDE + AHEAD])
    ball[0] = sign * HALF_GAP
    ankle = ball - foot @ BALL

    place, angles = hips(phase)
    pelvis = turn(0, angles[0]) @ turn(1, angles[1]) @ turn(2, angles[2])
    line = ankle - place - pelvis @ (SOCKET * [sign, 1, 1])
    # Thigh and shank are at an angle in the T pose; the knee turns on from there.
    sizes = np.linalg.norm(THIGH), np.linalg.norm(SHANK)
    between = (line @ line - sizes[0] ** 2 - sizes[1] ** 2) / (2 * sizes[0] * sizes[1])
    rest = np.arccos(THIGH @ SHANK / (sizes[0] * sizes[1]))
    if not between < np.cos(rest):
        raise ValueError(f"phase {phase:.3f}: the leg is too short")
    knee = float(np.arccos(between) - rest)
    bent = THIGH + turn(0, knee) @ SHANK
    side = np.array([1.0, 0.0, 0.0])
    down = line / np.linalg.norm(line)
    hinge = side - (side @ down) * down
    hinge /= np.linalg.norm(hinge)
    bent = bent / np.linalg.norm(bent)
    here = np.stack([side, bent, np.cross(side, bent)], axis=-1)
    there = np.stack([hinge, down, np.cross(hinge, down)], axis=-1)
    thigh = there @ here.T
    return {
        "hip": euler_xyz(pelvis.T @ thigh),
        "knee": np.array([knee]),
        "ankle": euler_xyz((thigh @ turn(0, knee)).T @ foot),
        "toe": np.radians([shape[1] - shape[0]]),
    }


def pose(phase: float) -> dict[str, Array]:
    """Return the value of every target; angles in degrees."""
    place, angles = hips(phase)
    made = {
        "joint/hips.translation": place - REST,
        "joint/hips.rotation": np.degrees(angles),
        "control/spine_twist": np.array([11.0 * wave(phase, 0.0)]),
        "control/spine_bend": np.array([3.0 + 1.5 * wave(phase, 0.03, 2)]),
        "control/spine_side": np.array([4.0 * wave(phase, 0.15)]),
        "control/look_x": np.array([-5.0 * wave(phase, 0.0)]),
    }
    for side, sign in (("l", 1.0), ("r", -1.0)):
        for name, value in leg(phase, sign).items():
            part = "angle" if name in {"knee", "toe"} else "rotation"
            made[f"joint/{name}_{side}.{part}"] = np.degrees(value)
        forward = 0.52 if sign > 0 else 0.02
        arm = -3.0 + 20.0 * wave(phase, forward)
        made[f"joint/shoulder_{side}.rotation"] = np.array([-arm, 0.0, -sign * 78.0])
        elbow = 22.0 + 9.0 * wave(phase, forward + 0.05)
        made[f"joint/elbow_{side}.angle"] = np.array([elbow])
    return made


def number(value: float) -> str:
    """Return six decimals, without zeros behind them."""
    return f"{round(float(value), 6) + 0.0:.6f}".rstrip("0").rstrip(".")


def listed(values: Array) -> str:
    """Return one number, or several as a YAML list."""
    text = ", ".join(number(v) for v in values)
    return text if len(values) == 1 else f"[{text}]"


def clip_text() -> str:
    """Return the clip as YAML."""
    step = 1e-5
    phases = [k / FRAMES for k in range(FRAMES + 1)]
    poses = [pose(p) for p in phases]
    behind = [pose(p + step) for p in phases]
    before = [pose(p - step) for p in phases]
    lines = [
        "# A walk cycle: two steps of 0.65 m in a second. Made by make_stride.py:",
        "# change it there. Handles are one frame long, at the velocity of the pose.",
        "clip: animtool/1",
        "name: stride",
        "rig: ../../rigs/biped/biped.rig.yaml",
        "units: {length: m, angle: deg}",
        "fps: 24",
        f"range: [1, {FRAMES}]",
        "channels:",
    ]
    for target in poses[0]:
        cycle = "cycle_offset" if target == "joint/hips.translation" else "cycle"
        lines += ["", f"- target: {target}"]
        if target.endswith(".rotation"):
            lines.append("  euler: XYZ")
        lines += ["  interp: hermite", f"  pre: {cycle}", f"  post: {cycle}", "  keys:"]
        for k, now in enumerate(poses):
            slope = (behind[k][target] - before[k][target]) / (2 * step * FRAMES)
            lines.append(
                f"  - {{t: {k + 1}, v: {listed(now[target])}, "
                f"in: [-1, {listed(-slope)}], out: [1, {listed(slope)}]}}"
            )
    return "\n".join([*lines, ""])


def main() -> None:
    """Write the clip to the file named on the command line."""
    parser = argparse.ArgumentParser(description="Make stride.clip.yaml.")
    props = Path(__file__).with_name("stride.clip.yaml")
    parser.add_argument("out", nargs="?", type=Path, default=props)
    out: Path = parser.parse_args().out
    out.write_text(clip_text(), encoding="utf-8", newline="\n")
    print(f"{out}: {FRAMES} frames")


if __name__ == "__main__":
    main()
