"""animtool's own retargeting, feet locked. Prints its seconds as JSON."""

import json
import sys
from pathlib import Path

from clock import timed

from animtool import open_source
from animtool.retarget import map_joints
from animtool.retarget.motion import retarget_take
from animtool.rig.file import load_rig
from animtool.rig.kinematics import forward_kinematics


def main(path: str, target: str, out: str) -> None:
    """Retarget a take, and write the positions of joints in each frame."""
    take = open_source(path).collect()
    bvh = target.endswith(".bvh")
    rig = open_source(target).collect().rig if bvh else load_rig(Path(target))
    joints = map_joints(take.rig, rig)
    # A first call loads what later ones use.
    motion = retarget_take(take, rig, joints).take.motion
    taken = timed(lambda: retarget_take(take, rig, joints))
    world = forward_kinematics(
        rig, motion.translations.dense(), motion.rotations.dense()
    )
    Path(out).write_text(json.dumps(world.positions.tolist()), "utf-8")
    print("\n" + json.dumps({"taken": [taken]}), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
