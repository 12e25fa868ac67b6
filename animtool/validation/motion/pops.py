"""Detects pops: discontinuities of joints and roots within one frame."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.errors import Fault, counted, listed
from animtool.core.record import dataclass
from animtool.maths.pops import find_rotation_pops, find_translation_pops
from animtool.validation.motion.body import body_carriers
from animtool.validation.motion.subject import MotionSubject

# Visible displacement of joints against their parents, where rigs may slide and stretch
# intentionally, and of a root, which is visible sooner [size].
MIN_POP_SHIFT, MIN_ROOT_SHIFT = 0.2, 0.02
CORRECTION_HINT = "correct the frames around it, or cut the take there"
# Displacement of joints by capture noise [size].
SHIFT_NOISE = 0.002


@dataclass(frozen=True, slots=True)
class _ChannelPops:
    """Pops of the N animated joints of a channel, over S steps between frames."""

    joints: IntArray  # joints of the columns ``(N,)``
    is_pop: BoolArray  # steps with a pop ``(S, N)``
    deviations: FloatArray  # distance from the motion around each step ``(S, N)``
    unit: str  # ``rad`` or ``m``

    def find_largest(self) -> tuple[int, int]:
        """Return step and column of the pop that is farthest off its surroundings."""
        deviations = np.where(self.is_pop, self.deviations, -1.0)
        step, column = np.unravel_index(int(deviations.argmax()), deviations.shape)
        return int(step), int(column)

    def size_text(self, step: int, column: int) -> str:
        """Return the deviation of a pop as text, in m or degrees."""
        deviation = float(self.deviations[step, column])
        if self.unit == "m":
            return f"{deviation:.3g} m"
        return f"{math.degrees(min(deviation, math.pi)):.0f}\N{DEGREE SIGN}"


def joint_pops(subject: MotionSubject) -> Iterator[Fault]:
    """Yield a fault if joints other than roots jump in one frame (MOT202)."""
    hint = CORRECTION_HINT
    if subject.is_intended_cut is not None:
        hint = "correct the frames around it; for an intended cut, write interp: step"
    pops = _find_pops(subject, MIN_POP_SHIFT, are_roots=False)
    yield from _pop_fault(subject, "MOT202", pops, hint)


def root_pops(subject: MotionSubject) -> Iterator[Fault]:
    """Yield a fault if a root, and all below it, jumps in one frame (MOT203)."""
    hint = CORRECTION_HINT
    pops = _find_pops(subject, MIN_ROOT_SHIFT, are_roots=True)
    yield from _pop_fault(subject, "MOT203", pops, hint)


def _find_pops(
    subject: MotionSubject, min_shift: float, *, are_roots: bool
) -> list[_ChannelPops]:
    """Return the pops of the roots, or of the other joints, by channel."""
    moving_joints = [*subject.take.rig.roots, *body_carriers(subject)]
    rotating_columns, translating_columns = (
        np.flatnonzero(np.isin(joints, moving_joints) == are_roots)
        for joints in (subject.rotating_joints, subject.translating_joints)
    )
    is_ignored = subject.cut_mask()
    is_ignored[:1] = True
    rotation_pops = find_rotation_pops(
        subject.rotation_steps[:, rotating_columns], subject.interval, is_ignored
    )
    shift_pops = find_translation_pops(
        subject.translation_steps[:, translating_columns],
        subject.interval,
        is_ignored,
        min_shift * subject.size,
        SHIFT_NOISE * subject.size,
    )
    return [
        _ChannelPops(subject.rotating_joints[rotating_columns], *rotation_pops, "rad"),
        _ChannelPops(subject.translating_joints[translating_columns], *shift_pops, "m"),
    ]


def _pop_fault(
    subject: MotionSubject, code: str, all_pops: list[_ChannelPops], hint: str
) -> Iterator[Fault]:
    """Yield one fault for all pops: the largest one, their number, other joints."""
    all_pops = [pops for pops in all_pops if pops.is_pop.any()]
    if not all_pops:
        return
    pops = all_pops[0]
    step, column = pops.find_largest()
    joint = int(pops.joints[column])
    jumping_names = {
        subject.take.rig.joints[int(pop_steps.joints[i])].name: None
        for pop_steps in all_pops
        for i in np.flatnonzero(pop_steps.is_pop.any(axis=0))
    }
    name = subject.take.rig.joints[joint].name
    steps = np.concatenate([np.flatnonzero(p.is_pop.any(axis=1)) for p in all_pops])
    step_count = len(np.unique(steps))
    frames_text = f"{subject.time_text(step)} to {subject.time_text(step + 1)}"
    message = (
        f"{name!r} jumps by {pops.size_text(step, column)} from frame {frames_text}, "
        "unlike the motion around it"
    )
    other_names = [other_name for other_name in jumping_names if other_name != name]
    if step_count > 1:
        message += f"; there are {step_count} such steps in total"
    if other_names:
        message += f"; also {listed(other_names)}"
    yield subject.fault(code, joint, step, message, hint)


def reference_pose(subject: MotionSubject) -> Iterator[Fault]:
    """Yield a fault if the first frame is a reference pose (MOT204)."""
    leaving_joints = subject.joints_leaving_pose
    if not len(leaving_joints):
        return
    first_code, second_code = subject.time_text(0), subject.time_text(1)
    message = (
        f"frame {first_code} is an isolated pose: "
        f"{counted(len(leaving_joints), 'joint')} "
        f"{'jumps' if len(leaving_joints) == 1 else 'jump'} between frames "
        f"{first_code} and {second_code}"
    )
    hint = f"remove it with the pass 'trim: {{first: {second_code}}}'"
    yield subject.fault("MOT204", int(leaving_joints[0]), 0, message, hint)
