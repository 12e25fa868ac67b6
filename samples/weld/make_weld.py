"""Make ``weld.npz``, the path of a torch round the joint of two pipes.

A branch pipe stands on a main pipe. The seam is where their outsides meet. The torch
points into the corner between them, as far from the one as from the other, and leans
back so that it pushes the weld before it. Its neck is bent by 45°, and the gripper that
holds it stays above the work.

Lengths are metres. Z is up, the main pipe lies along Y, the arm stands at the origin.

Usage: ``python make_weld.py [OUT]``; ``OUT`` is ``weld.npz`` beside this file unless
given.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from animtool.maths import so3

Array = NDArray[np.float64]

FPS = 25
SPEED = 0.02  # [m/s] along the seam
BRANCH, MAIN = 0.05, 0.08  # [m] radii
CROSSING = np.array([0.56, 0.0, 0.20])  # where the pipes' axes meet
LEAN = 10.0  # [deg] of the torch against the way it goes
FIRST = 200.0  # [deg] round the branch where it begins: 180 faces the arm
LAP = 20.0  # [deg] that the end of the seam goes over its beginning

# In frames: the torch comes, speeds up, welds, slows down and leaves.
COME, RAMP, LEAVE = 75, 12, 36
TIP = np.array([0.124, 0.0, -0.064])  # [m] of the torch, seen from the tool
REST = np.array([0.72, 0.0, 0.86])  # [m] of the tool, which is not turned there
OVER = np.array([0.40, 0.0, 0.50])  # [m] that the tip comes round by
AWAY = np.array([-0.06, 0.0, 0.12])  # [m] from the seam to where it leaves to
DOWN = np.array([0.0, 0.0, -1.0])


def seam(angles: Array) -> Array:
    """Return points of the seam ``(N, 3)`` at angles round the branch [rad]."""
    x, y = BRANCH * np.cos(angles), BRANCH * np.sin(angles)
    return CROSSING + np.stack([x, y, np.sqrt(MAIN**2 - x**2)], axis=1)


def unit(vectors: Array) -> Array:
    """Return vectors ``(N, 3)`` of length 1."""
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))


def torch_directions(angles: Array) -> Array:
    """Return unit directions in which the torch points ``(N, 3)``."""
    branch = np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1)
    main = seam(angles) - CROSSING
    main[:, 1] = 0.0
    halfway = unit(branch + unit(main))
    step = 1e-5
    along = unit(seam(angles + step) - seam(angles - step))
    lean = np.radians(LEAN)
    return unit(np.sin(lean) * along - np.cos(lean) * halfway)


def tool_axes(directions: Array) -> Array:
    """Return axes of the tool, as columns ``(N, 3, 3)``, with the torch in directions.

    The torch points along (1, 0, -1) of the tool, and the tool as far down as it can.
    """
    below = unit(DOWN - (directions @ DOWN)[:, None] * directions)
    x = (directions + below) / np.sqrt(2)
    z = (below - directions) / np.sqrt(2)
    return np.stack([x, np.cross(z, x), z], axis=2)


def ease(share: Array) -> Array:
    """Return 0 to 1 with neither speed nor acceleration at the ends."""
    u = np.clip(share, 0.0, 1.0)
    return np.asarray(u**3 * (u * (6 * u - 15) + 10))


def angles_of_weld() -> Array:
    """Return where the torch is in each frame of the weld, round the branch [rad]."""
    angles = np.radians(np.linspace(FIRST, FIRST + 360 + LAP, 40_001))
    steps = np.linalg.norm(np.diff(seam(angles), axis=0), axis=1)
    lengths = np.concatenate([[0.0], np.cumsum(steps)])
    count = int(np.ceil(lengths[-1] / SPEED * FPS)) - 1 + RAMP
    speeds = ease((np.arange(count) + 0.5) / RAMP)
    travelled = np.cumsum(speeds * speeds[::-1]) * SPEED / FPS
    return np.interp(np.concatenate([[0.0], travelled]), lengths, angles)


def coming(tip: Array, axes: Array) -> tuple[Array, Array]:
    """Return the way from rest: tips ``(N, 3)`` and rotations of the tool ``(N, 4)``.

    At rest the wrist is straight, and bends any way at once by turning two axes against
    each other. So the tool begins by its pitch; yaw and roll come after it.
    """
    share = ease(np.arange(COME) / COME)
    pitch = np.arcsin(-axes[2, 0])
    yaw = np.arctan2(axes[1, 0], axes[0, 0])
    roll = np.arctan2(axes[2, 1], axes[2, 2])
    turns = so3.multiply(
        so3.from_axis_angle([0.0, 0.0, 1.0], yaw * share**2),
        so3.multiply(
            so3.from_axis_angle([0.0, 1.0, 0.0], pitch * share),
            so3.from_axis_angle([1.0, 0.0, 0.0], roll * share**2),
        ),
    )
    s = share[:, None]
    tips = (1 - s) ** 2 * (REST + TIP) + 2 * s * (1 - s) * OVER + s**2 * tip
    return tips, turns


def path() -> tuple[Array, Array]:
    """Return the tip ``(F, 3)`` and the tool's quaternions [w, x, y, z] ``(F, 4)``."""
    angles = angles_of_weld()
    tips, axes = seam(angles), tool_axes(torch_directions(angles))
    turns = so3.from_matrix(axes)
    first, before = coming(tips[0], axes[0])
    after = tips[-1] + ease(np.arange(1, LEAVE + 1) / LEAVE)[:, None] * AWAY
    whole = np.concatenate([before, turns, turns[[-1] * LEAVE]])
    return np.concatenate([first, tips, after]), so3.align_signs(whole)[:, [3, 0, 1, 2]]


def main() -> None:
    """Write the path to the file named on the command line."""
    parser = argparse.ArgumentParser(description="Make the path of the torch.")
    props = Path(__file__).with_name("weld.npz")
    parser.add_argument("out", nargs="?", type=Path, default=props)
    tips, turns = path()
    np.savez_compressed(parser.parse_args().out, tip=tips, turn=turns)


if __name__ == "__main__":
    main()
