"""Detects pops: discontinuities of joints and roots within one frame."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.errors import Fault, listed
from animtool.core.record import dataclass
from animtool.maths.pops import find_rotation_pops, find_translation_pops
from animtool.validation.motion.body import body_carriers
from animtool.validation.motion.subject import MotionSubject

# Visible displacement of joints against their parents, where rigs may slide and stretch
# intentionally, and of a root, which is visible sooner [size].
MIN_POP_SHIFT, MIN_ROOT_SHIFT = 0.2, 0.02
CORRECT_HINT = "correct the frames around it, or cut the take there"
# Displacement of joints by capture noise [size].
SHIFT_NOISE = 0.002


@dataclass(frozen=True, slots=True)
class _PopSteps:
    """Steps between frames in which columns of a channel pop."""

    joints: IntArray  # joints of the columns ``(N,)``
    flags: BoolArray  # steps with a pop ``(S, N)``
    amounts: FloatArray  # distance of each step from the surrounding motion ``(S, N)``
    unit: str  # ``rad`` or ``m``

    def worst(self) -> tuple[int, int]:
        """Return the step and the column of the largest pop."""
        amounts = np.where(self.flags, self.amounts, -1.0)
        step, column = np.unravel_index(int(amounts.argmax()), amounts.shape)
        return int(step), int(column)

    def size_text(self, step: int, column: int) -> str:
        """Return the size of a pop as text with unit."""
        amount = float(self.amounts[step, column])
        if self.unit == "m":
            return f"{amount:.3g} m"
        return f"{math.degrees(min(amount, math.pi)):.0f}\N{DEGREE SIGN}"


def joint_pops(subject: MotionSubject) -> Iterator[Fault]:
    """Yield a fault if joints other than roots jump in one frame (MOT202)."""
    hint = CORRECT_HINT
    if subject.intended_cuts is not None:
        hint = "correct the frames around it; for an intended cut, write interp: step"
    pops = _find_pops(subject, MIN_POP_SHIFT, roots=False)
    yield from _pop_fault(subject, "MOT202", pops, hint)


def root_pops(subject: MotionSubject) -> Iterator[Fault]:
    """Yield a fault if a root, and all below it, jumps in one frame (MOT203)."""
    hint = CORRECT_HINT
    pops = _find_pops(subject, MIN_ROOT_SHIFT, roots=True)
    yield from _pop_fault(subject, "MOT203", pops, hint)


def _find_pops(
    subject: MotionSubject, min_shift: float, *, roots: bool
) -> list[_PopSteps]:
    """Return the rotation pops and translation pops of roots or of the other joints."""
    moving_joints = [*subject.take.rig.roots, *body_carriers(subject)]
    rotating, translating = (
        np.flatnonzero(np.isin(joints, moving_joints) == roots)
        for joints in (subject.rotating_joints, subject.translating_joints)
    )
    is_ignored = subject.cuts()
    is_ignored[:1] = True
    rotation_pops = find_rotation_pops(
        subject.rotation_steps[:, rotating], subject.interval, is_ignored
    )
    shift_pops = find_translation_pops(
        subject.translation_steps[:, translating],
        subject.interval,
        is_ignored,
        min_shift * subject.size,
        SHIFT_NOISE * subject.size,
    )
    return [
        _PopSteps(subject.rotating_joints[rotating], *rotation_pops, "rad"),
        _PopSteps(subject.translating_joints[translating], *shift_pops, "m"),
    ]


def _pop_fault(
    subject: MotionSubject, code: str, all_pops: list[_PopSteps], hint: str
) -> Iterator[Fault]:
    """Yield one fault that counts the pops of a kind and names the largest one."""
    all_pops = [pops for pops in all_pops if pops.flags.any()]
    if not all_pops:
        return
    pops = all_pops[0]
    step, column = pops.worst()
    joint = int(pops.joints[column])
    names = {
        subject.take.rig.joints[int(entry.joints[i])].name: None
        for entry in all_pops
        for i in np.flatnonzero(entry.flags.any(axis=0))
    }
    name = subject.take.rig.joints[joint].name
    steps = np.concatenate([np.flatnonzero(p.flags.any(axis=1)) for p in all_pops])
    step_count = len(np.unique(steps))
    frames_text = f"{subject.time_text(step)} to {subject.time_text(step + 1)}"
    message = (
        f"{name!r} jumps by {pops.size_text(step, column)} from frame {frames_text}, "
        "unlike the motion around it"
    )
    other_names = [other_name for other_name in names if other_name != name]
    if step_count > 1:
        message += f"; there are {step_count} such steps in total"
    if other_names:
        message += f"; also {listed(other_names)}"
    yield subject.fault(code, joint, step, message, hint)


def reference_pose(subject: MotionSubject) -> Iterator[Fault]:
    """Yield a fault if the first frame is a reference pose (MOT204)."""
    pose = subject.joints_leaving_pose
    if not len(pose):
        return
    first_code, second_code = subject.time_text(0), subject.time_text(1)
    message = (
        f"frame {first_code} is an isolated pose: {len(pose)} joints jump to that of "
        f"frame {second_code}"
    )
    hint = f"the pass trim: {{first: {second_code}}} removes it"
    yield subject.fault("MOT204", int(pose[0]), 0, message, hint)
