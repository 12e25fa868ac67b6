"""Targets files, and takes to bring to them, made for tests."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.clock import Clock
from animtool.ik.file import load_targets
from animtool.ik.tracks import TargetTracks
from animtool.maths import so3
from animtool.motion.motion import Channel, Motion
from animtool.motion.take import Take
from animtool.rig.limits import RangeLimit
from animtool.rig.parts import IkChain
from animtool.rig.skeleton import Joint, JointType, Rig

HEAD = "targets: animtool/1\nunits: {length: m, angle: deg}\nfps: 24\n"


def legs() -> Rig:
    """Hips that travel, two legs with knees that bend forwards, and a tail."""
    joints = [Joint("hips", -1, JointType.FREE, translation=(0.0, 0.9, 0.0))]
    chains = []
    for side, x in (("l", 0.1), ("r", -0.1)):
        base = len(joints)
        joints += [
            Joint(f"hip_{side}", 0, JointType.BALL, translation=(x, -0.05, 0.0)),
            Joint(
                f"knee_{side}",
                base,
                JointType.PIN,
                translation=(0.0, -0.42, 0.01),
                axis=(1.0, 0.0, 0.0),
                limits=RangeLimit(0.0, 2.6),
            ),
            Joint(
                f"ankle_{side}", base + 1, JointType.BALL, translation=(0, -0.4, -0.02)
            ),
        ]
        chain = IkChain(
            f"leg_{side}", f"hip_{side}", f"ankle_{side}", "pose", (0.0, 0.0, 1.0)
        )
        chains.append(chain)
    joints.append(Joint("tail", 0, JointType.BALL, translation=(0.0, 0.0, -0.1)))
    return Rig("legs", tuple(joints), chains=tuple(chains))


def walk_of(rig: Rig, count: int = 40, step: Fraction = Fraction(1)) -> Take:
    """Return a take in which the hips travel and turn and every joint moves."""
    phase = np.arange(count) * float(step) / 9.0
    translations = np.repeat(rig.rest_translations[None], count, axis=0)
    rotations = np.repeat(rig.rest_rotations[None], count, axis=0)
    for j, joint in enumerate(rig.joints):
        if joint.type is JointType.FREE:
            away = [0.1 * phase, 0.03 * np.sin(phase), 0.04 * phase]
            translations[:, j] += np.stack(away, axis=1)
        if joint.type in {JointType.FREE, JointType.BALL}:
            angles = np.stack([np.sin(phase + j), np.cos(phase * 0.7), 0 * phase], 1)
            turn = so3.exp(0.12 * angles)
        elif joint.type is JointType.PIN:
            turn = so3.from_axis_angle(joint.axis, 0.8 + 0.4 * np.sin(phase + j))
        else:
            continue
        rotations[:, j] = so3.multiply(rotations[:, j], turn)
    clock = Clock(Fraction(24), Fraction(1), step, count)
    motion = Motion(
        Channel.from_dense(translations), Channel.from_dense(so3.align_signs(rotations))
    )
    return Take(rig, clock, motion)


def write_targets(folder: Path, goals: str, head: str = HEAD) -> Path:
    """Write a targets file."""
    path = folder / "feet.targets.yaml"
    path.write_text(f"{head}goals:\n{goals}")
    return path


def tracks_of(
    folder: Path, goals: str, rig: Rig | None = None, head: str = HEAD
) -> TargetTracks:
    """Return the tracks of a targets file, written and read."""
    return load_targets(write_targets(folder, goals, head), rig or legs())


def point_of(take: Take, name: str) -> FloatArray:
    """Return where a joint is in every frame ``(F, 3)``."""
    return take.world().positions[:, take.rig.index(name)]
