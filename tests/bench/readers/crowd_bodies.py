"""Hips of every character of a layer by frame, and its feet as they stand, read by pxr.

    python tests/bench/readers/crowd_bodies.py square.usdc

Nothing of animtool is asked: places of joints are UsdSkel's in the prims' LocalToWorld,
on level ground. A foot is on the ground where the lower of its heel and its ball is
within `GROUND` of it in two frames on end, and slides as far as that point goes between
them. Who lies, and who falls or gets up, is left out.
"""

from __future__ import annotations

import argparse
import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
from pxr import Usd, UsdGeom, UsdSkel

Floats = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]
# A sole is on the ground where it is less above it [m].
GROUND = 0.005
# Lowest joints are less above the soles, over how high hips are.
SOLE = 0.1
# Who lies: the head is less than this above the hips, over the way between; some time
# before and after one falls or gets up [s].
UPRIGHT, FALLING = 0.5, 1.0
# Bounds: of slides and of vertical steps a frame at 24 fps [m], of hips as they stand.
SLIDE, STEP, STANDING = 0.005, 0.1, 0.8
LEGS = (("ankle_l", "foot_l", "LeftFoot"), ("ankle_r", "foot_r", "RightFoot"))
TOES = (("toe_l", "ball_l", "LeftToeBase"), ("toe_r", "ball_r", "RightToeBase"))
HIPS, HEAD = ("hips", "pelvis", "Hips", "root"), ("head", "Head")


@dataclass(frozen=True)
class Character:
    """A character over F frames, y up.

    Attributes:
        name: Its prim.
        hips: Places ``(F, 3)`` [m].
        fallen: When it lies, falls or gets up ``(F,)``.
        stood: How high its hips are in the pose of rest [m].
        soles: Heel and ball of both feet ``(F, 2, 2, 3)`` [m].
    """

    name: str
    hips: Floats
    fallen: Bools
    stood: float
    soles: Floats

    @property
    def steps(self) -> Floats:
        """How far hips go up or down to the next frame, but in a fall ``(F - 1,)``."""
        made = np.abs(np.diff(self.hips[:, 1]))
        return np.where(self.fallen[1:] | self.fallen[:-1], 0.0, made)

    @property
    def heights(self) -> Floats:
        """How high hips are of the pose of rest; 1 as it has fallen ``(F,)``."""
        return np.where(self.fallen, 1.0, self.hips[:, 1] / self.stood)

    @property
    def slides(self) -> Floats:
        """How far feet on the ground go to the next frame ``(F - 1, 2)`` [m]."""
        low = self.soles[..., 1] < GROUND
        both = low[1:] & low[:-1]
        way = np.linalg.norm(np.diff(self.soles[..., [0, 2]], axis=0), axis=-1)
        # Of heel and ball on the ground the one that goes less is what it stands on.
        way = np.where(both, way, np.inf).min(axis=2)
        way[~both.any(axis=2)] = 0.0
        way[self.fallen[1:] | self.fallen[:-1]] = 0.0
        return np.asarray(way)


def _joint(names: list[str], known: tuple[str, ...]) -> int:
    return next(names.index(name) for name in known if name in names)


def characters(path: Path) -> tuple[list[Character], float]:
    """Return the characters of a layer, and its time codes a second."""
    stage = Usd.Stage.Open(str(path))
    codes = np.arange(stage.GetStartTimeCode(), stage.GetEndTimeCode() + 1)
    fps = stage.GetTimeCodesPerSecond()
    unit = UsdGeom.GetStageMetersPerUnit(stage)
    cache, found = UsdSkel.Cache(), []
    proxies = Usd.TraverseInstanceProxies()
    for prim in stage.Traverse(proxies):
        if prim.IsA(UsdSkel.Root):
            cache.Populate(UsdSkel.Root(prim), proxies)
        if prim.IsA(UsdSkel.Skeleton):
            query = cache.GetSkelQuery(UsdSkel.Skeleton(prim))
            found.append(_character(prim, query, codes, fps, unit))
    return found, fps


def _character(
    prim: Usd.Prim, query: UsdSkel.SkeletonQuery, codes: Floats, fps: float, unit: float
) -> Character:
    names = [str(one).rsplit("/", 1)[-1] for one in query.GetJointOrder()]
    feet, toes = ([_joint(names, one) for one in each] for each in (LEGS, TOES))
    hips, head = _joint(names, HIPS), _joint(names, HEAD)
    rest = np.array(query.ComputeJointSkelTransforms(Usd.TimeCode.Default(), True))
    ground = float(rest[:, 3, 1].min())
    # Joints are above soles: a rig whose lowest is just above its origin stands there.
    if 0 < ground < SOLE * rest[hips, 3, 1]:
        ground = 0.0
    # On the ground below the ankle, as the foot has it, and below the joint of toes,
    # which a foot rolls about whose heel is up.
    soles = np.ones((2, 2, 4))
    for k in range(2):
        back = np.linalg.inv(rest[feet[k]])
        for e, joint in enumerate((feet[k], toes[k])):
            point = np.array([rest[joint, 3, 0], ground, rest[joint, 3, 2], 1.0])
            soles[k, e] = point @ back
    places, made = np.zeros((len(codes), 2, 3)), np.zeros((len(codes), 2, 2, 3))
    scale = 1.0
    for f, code in enumerate(codes.tolist()):
        joints = np.array(query.ComputeJointSkelTransforms(code))
        world = np.array(UsdGeom.XformCache(code).GetLocalToWorldTransform(prim))
        places[f] = (joints[[hips, head], 3] @ world)[:, :3] * unit
        for k in range(2):
            made[f, k] = (soles[k] @ joints[feet[k]] @ world)[:, :3] * unit
            made[f, k, 1] = (joints[toes[k], 3] @ world)[:3] * unit
        scale = float(np.linalg.norm(world[1, :3]))
        made[f, :, 1, 1] -= (rest[toes, 3, 1] - ground) * scale * unit
    stood = (rest[hips, 3, 1] - ground) * scale * unit
    spine = places[:, 1] - places[:, 0]
    lies = spine[:, 1] < UPRIGHT * np.linalg.norm(spine, axis=1)
    frames, near = np.flatnonzero(lies), round(FALLING * fps)
    away = np.abs(np.arange(len(codes))[:, None] - frames).min(axis=1, initial=10**6)
    path = next(p for p in prim.GetPath().GetPrefixes() if p.name.startswith("agent"))
    return Character(path.name, places[:, 0], away <= near, stood, made)


def main() -> None:
    """Read a layer, print what was found."""
    made = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    made.add_argument("layer", type=Path)
    made.add_argument("--csv", type=Path, help="hips and slides by character and frame")
    made.add_argument("--worst", type=int, default=5, help="so many are named")
    options = made.parse_args()
    found, fps = characters(options.layer)
    most = STEP * 24 / fps
    lows = [float(one.heights.min()) for one in found]
    ups = [float(one.steps.max(initial=0.0)) for one in found]
    slides = [float(one.slides.max(initial=0.0)) for one in found]
    frames = sum(int((one.slides > SLIDE).sum()) for one in found)
    stances = sum(int((one.slides > 0).sum()) for one in found)
    fallen = sum(bool(one.fallen.any()) for one in found)
    print(f"{len(found)} characters, {fallen} fall")
    for text, values, bad in (
        ("hips, least over those at rest", lows, [v < STANDING for v in lows]),
        ("vertical step of hips [m]", ups, [v > most for v in ups]),
        ("slide of a foot on the ground [m]", slides, [v > SLIDE for v in slides]),
    ):
        last = "least" in text
        order = np.argsort(values if last else -np.array(values), kind="stable")
        worst = ", ".join(
            f"{found[i].name} {values[i]:.4f}" for i in order[: options.worst]
        )
        print(f"{text}: {sum(bad)} beyond the bound; {worst}")
    print(f"{frames} of {stances} foot frames slide more than {SLIDE} m")
    if options.csv is not None:
        with options.csv.open("w", newline="") as file:
            rows = csv.writer(file)
            rows.writerow(["character", "frame", "hips", "fallen", "left", "right"])
            for one in found:
                slid = np.vstack([np.zeros((1, 2)), one.slides])
                for f in range(len(one.hips)):
                    rows.writerow(
                        [one.name, f, f"{one.hips[f, 1]:.5f}", int(one.fallen[f])]
                        + [f"{value:.5f}" for value in slid[f]]
                    )


if __name__ == "__main__":
    main()
