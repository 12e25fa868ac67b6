"""Write a BVH of a size: ``python preview_take.py FILE FRAMES JOINTS RATE``."""

from __future__ import annotations

import sys
from fractions import Fraction
from pathlib import Path

import numpy as np

from animtool import Channel, Clock, Joint, Motion, Rig, Take, write_bvh
from animtool.maths import so3


def write_take(path: Path, frames: int, joint_count: int, rate: int) -> None:
    """Write a BVH whose joints all turn, with the noise of a capture."""
    rng = np.random.default_rng(1)
    joints = [Joint("hips", -1, translation=(0.0, 1.0, 0.0))]
    for j in range(1, joint_count):
        above = j - 1 if j % 6 else 0
        joints.append(Joint(f"joint_{j}", above, translation=(0.05, 0.1, 0.01)))
    rig = Rig("performer", tuple(joints), meters_per_unit=0.01)
    times = np.arange(frames) / rate
    rates, phases = (
        rng.uniform(0.2, 3, (joint_count, 3)),
        rng.uniform(0, 6, (joint_count, 3)),
    )
    sizes = rng.uniform(0.05, 0.4, (joint_count, 3))
    swing = sizes * np.sin(2 * np.pi * rates * times[:, None, None] + phases)
    turns = so3.exp(swing + rng.normal(0, 0.002, swing.shape))
    places = np.repeat(rig.rest_translations[None], frames, axis=0)
    places[:, 0] += np.stack([0 * times, 0.03 * np.sin(3 * times), 0.8 * times], axis=1)
    motion = Motion(
        Channel.from_dense(places), Channel.from_dense(so3.align_signs(turns))
    )
    clock = Clock(Fraction(rate), Fraction(1), Fraction(1), frames)
    write_bvh(Take(rig, clock, motion), path)


if __name__ == "__main__":
    write_take(Path(sys.argv[1]), *map(int, sys.argv[2:]))
