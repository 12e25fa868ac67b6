"""Measures a take of a body: steps, ground speed and noise."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.record import dataclass
from animtool.maths.filters import rotation_noise
from animtool.maths.runs import runs
from animtool.motion.contacts import find_contacts, gaussian_smooth
from animtool.motion.take import Take
from animtool.retarget.anatomy import find_anatomy
from animtool.retarget.legs import up_index
from animtool.retarget.roled_skeleton import RoledSkeleton
from animtool.retarget.transfer import middle_of_hips

# Smoothing time of hip speeds [s]: the hips sway with each step.
SPEED_INTERVAL = 0.25
# Frames whose joints are held in memory at once.
BLOCK_FRAMES = 1024


@dataclass(frozen=True, slots=True)
class FootFacts:
    """Contact statistics of a foot: how often and how long it is planted."""

    standing: float  # fraction of frames in which the foot is planted
    steps: int  # number of contacts


@dataclass(frozen=True, slots=True)
class CaptureFacts:
    """Statistics of a captured take: foot contacts, ground speed and noise."""

    feet: dict[str, FootFacts]  # by side, ``left`` and ``right``
    speed_mean: float  # mean ground speed of the hips [m/s]
    speed_max: float
    noise: float  # standard deviation of the noisiest joint's rotation [rad]
    noisiest: str  # name of that joint; empty if none rotates


def measure_capture(take: Take) -> CaptureFacts | None:
    """Return the statistics of a take; None if it has no body with legs.

    Limits: feet are detected by their speed and height, the body by its structure.
    """
    rig = take.rig
    if not rig.joints:
        return None
    skeleton = RoledSkeleton.of(rig, find_anatomy(rig).roles)
    leg_by_side = {side: skeleton.leg(side) for side in "lr"}
    if not any(leg_by_side.values()) or take.clock.count < 2:
        return None
    feet_joints = {
        j for leg in leg_by_side.values() if leg is not None for j in leg[2:]
    }
    hips, positions = joint_positions(take, skeleton, sorted(feet_joints))
    up, fps = up_index(rig), float(take.clock.rate)
    facts_by_side = {}
    for side, leg in leg_by_side.items():
        if leg is None:
            continue
        toe = positions.get(leg[3])
        leg_length = skeleton.leg_length(side)
        is_planted = find_contacts(positions[leg[2]], toe, fps, leg_length, up).any
        steps = sum(start > 0 for start, _ in runs(is_planted))
        name = "left" if side == "l" else "right"
        facts_by_side[name] = FootFacts(float(is_planted.mean()), steps)
    speeds = ground_speeds(take, hips)
    noise, noisiest = _noisiest_joint(take)
    return CaptureFacts(
        facts_by_side, float(speeds.mean()), float(speeds.max()), noise, noisiest
    )


def joint_positions(
    take: Take, skeleton: RoledSkeleton, joints: Sequence[int]
) -> tuple[FloatArray, dict[int, FloatArray]]:
    """Return the positions of the hips' middle and of each joint, ``(F, 3)`` [m]."""
    valid_joints = [j for j in joints if j >= 0]
    hips, positions = [], []
    for begin in range(0, take.clock.count, BLOCK_FRAMES):
        block = take.motion.select(slice(begin, begin + BLOCK_FRAMES))
        world = block.world(take.rig).positions
        hips.append(middle_of_hips(skeleton, world))
        positions.append(world[:, valid_joints])
    all_positions = np.concatenate(positions)
    return np.concatenate(hips), {
        j: all_positions[:, k] for k, j in enumerate(valid_joints)
    }


def ground_speeds(take: Take, hips: FloatArray) -> FloatArray:
    """Return the horizontal speed of hips ``(F, 3)`` per frame ``(F - 1,)`` [m/s]."""
    fps = float(take.clock.rate)
    ground_path = np.delete(hips, up_index(take.rig), axis=1)
    smooth_path = gaussian_smooth(ground_path, SPEED_INTERVAL / 2 * fps)
    return np.asarray(np.linalg.norm(np.diff(smooth_path, axis=0), axis=1) * fps)


def _noisiest_joint(take: Take) -> tuple[float, str]:
    """Return the largest rotation noise of any joint [rad], and that joint's name."""
    channel = take.motion.rotations
    noise_levels = [
        rotation_noise(channel.values[:, k]) for k in range(len(channel.animated))
    ]
    if not noise_levels:
        return 0.0, ""
    noisiest_index = int(np.argmax(noise_levels))
    joint = int(channel.animated[noisiest_index])
    return noise_levels[noisiest_index], take.rig.names[joint]
