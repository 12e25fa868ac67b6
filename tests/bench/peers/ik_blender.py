"""Blender's own inverse kinematics: bones that turn about x, an IK constraint."""

import bpy
import numpy as np
from ik_problems import Array, Case, about, angles, matrices
from ik_serve import Descents, Solver, serve
from mathutils import Matrix

# Of an update: the quickest on the arms.
ITERATIONS = 60
# Of bones [m]; nothing but their heads and axes counts.
LENGTH = 0.05


class Steps:
    """An armature; a step is an update of the scene from the pose of before."""

    def __init__(self, case: Case) -> None:
        self.case = case
        moving = [j for j, joint in enumerate(case.joints) if joint["type"] == "pin"]
        limits = np.array([case.joints[j]["limits"] for j in moving], float)
        # Blender's limits are on both sides of the rest pose.
        self.middle = limits.mean(axis=1)
        self.low, self.high = limits.T
        data = bpy.data.armatures.new("chain")
        self.armature = bpy.data.objects.new("chain", data)
        self.goal = bpy.data.objects.new("goal", None)
        scene = bpy.context.scene.collection.objects
        scene.link(self.armature)
        scene.link(self.goal)
        self._bones(moving)
        self.bones = [self.armature.pose.bones[f"j{j}"] for j in moving]
        self.tip = self.armature.pose.bones["tip"]
        for bone, low, high in zip(
            self.bones, self.low - self.middle, self.high - self.middle, strict=True
        ):
            bone.rotation_mode = "XYZ"
            bone.lock_ik_y = bone.lock_ik_z = bone.use_ik_limit_x = True
            bone.ik_min_x, bone.ik_max_x = low, high
        self.tip.lock_ik_x = self.tip.lock_ik_y = self.tip.lock_ik_z = True
        self.constraint = self.tip.constraints.new("IK")
        self.constraint.target = self.goal
        self.constraint.use_rotation = True
        self.constraint.iterations = ITERATIONS
        self.points, self.turns = case.targets["pos"][:, 0], case.targets["rot"][:, 0]
        self.found = self.middle
        self.frame = 0

    def _bones(self, moving: list[int]) -> None:
        bpy.context.view_layer.objects.active = self.armature
        bpy.ops.object.mode_set(mode="EDIT")
        parent, placed = None, np.eye(4)
        chain, at = [], self.case.owners[0]
        while at >= 0:
            chain.append(at)
            at = self.case.joints[at]["parent"]
        for j in reversed(chain):
            joint = self.case.joints[j]
            offset = np.eye(4)
            offset[:3, :3] = matrices(joint["offset_r"])
            offset[:3, 3] = joint["offset_t"]
            placed = placed @ offset
            if joint["type"] != "pin":
                continue
            turn = np.eye(4)
            middle = self.middle[moving.index(j)]
            turn[:3, :3] = about(joint["axis"], np.array([middle]))[0]
            placed = placed @ turn
            frame = placed.copy()
            frame[:3, :3] = placed[:3, :3] @ _from_x(np.array(joint["axis"], float))
            parent = self._bone(f"j{j}", frame, parent)
        frame = placed.copy()
        offset = np.array(self.case.effectors[0]["offset"], float)
        frame[:3, 3] += placed[:3, :3] @ (offset - [0, LENGTH, 0])
        self._bone("tip", frame, parent)
        bpy.ops.object.mode_set(mode="OBJECT")

    def _bone(self, name: str, frame: Array, parent: object) -> object:
        bone = self.armature.data.edit_bones.new(name)
        bone.head, bone.tail = (0, 0, 0), (0, LENGTH, 0)
        bone.matrix = Matrix(frame.tolist())
        bone.parent = parent
        return bone

    def aim(self, frame: int) -> None:
        self.frame = frame
        placed = np.eye(4)
        placed[:3, :3], placed[:3, 3] = self.turns[frame], self.points[frame]
        self.goal.matrix_world = Matrix(placed.tolist())

    def put(self, pose: Array) -> None:
        for bone, angle in zip(self.bones, pose - self.middle, strict=True):
            bone.rotation_euler[0] = angle
        self.armature.update_tag()
        bpy.context.view_layer.update()
        found = []
        for bone in self.bones:
            local = self.armature.convert_space(
                pose_bone=bone, matrix=bone.matrix, from_space="POSE", to_space="LOCAL"
            )
            found.append(np.arctan2(local[2][1], local[2][2]))
        self.found = self.middle + found

    def pose(self) -> Array:
        return np.clip(self.found, self.low, self.high)

    def step(self) -> bool:
        self.put(self.pose())
        return True

    def misses(self) -> tuple[float, float]:
        placed = np.array(self.tip.matrix)
        away = np.array(self.tip.tail) - self.points[self.frame]
        turn = self.turns[self.frame] @ placed[:3, :3].T
        return float(np.linalg.norm(away)), float(angles(turn))

    def cost(self) -> float:
        away, angle = self.misses()
        return away**2 + angle**2


def _from_x(axis: Array) -> Array:
    """Return a rotation that brings x to an axis."""
    other = np.eye(3)[np.argmin(np.abs(axis))]
    y = np.cross(other, axis)
    y /= np.linalg.norm(y)
    return np.stack([axis, y, np.cross(axis, y)], 1)


class Blender(Descents):
    """Blender with restarts."""

    def places(self, pose: Array) -> tuple[Array, Array]:
        steps = self.stepper
        assert isinstance(steps, Steps)
        steps.constraint.mute = True
        steps.put(pose)
        steps.constraint.mute = False
        placed = np.array(steps.tip.matrix)
        return placed[None, :3, :3], np.array(steps.tip.tail)[None]


def build(case: Case) -> Solver:
    return Blender(Steps(case), case)


if __name__ == "__main__":
    bpy.ops.wm.read_factory_settings(use_empty=True)
    serve(build)
