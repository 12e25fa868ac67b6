"""The pass ik: what it tells the passes after it."""

from __future__ import annotations

from pathlib import Path

from support.targets import legs, walk_of, write_targets

from animtool.ik.take_pass import PASS
from animtool.motion.passes import PassContext, apply_pass, find_pass
from animtool.motion.take import TakeStream


def test_joints_at_targets_are_placed_until_times_change(tmp_path: Path) -> None:
    take = walk_of(legs(), count=12)
    path = write_targets(tmp_path, "- {effector: leg_l, hold: [[4, 8]], ease: 0}\n")
    context = PassContext(lambda _: take, tmp_path)
    options = PASS.options(targets=Path(path.name))
    solved = apply_pass(TakeStream.of(take), PASS, options, context).collect()
    (placed,) = context.placed_joints
    assert (placed.joint, placed.effector) == ("ankle_l", "leg_l")
    assert placed.times.tolist() == [4, 5, 6, 7, 8]
    trim = find_pass("trim")
    apply_pass(TakeStream.of(solved), trim, trim.options(first=2), context)
    assert context.placed_joints == []
