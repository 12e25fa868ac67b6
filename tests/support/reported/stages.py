"""USD as pxr reads it: in metres, Y up, at every frame of its range."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from pxr import Sdf, Usd, UsdGeom, UsdSkel

from support.reported.outcome import require

Floats = npt.NDArray[np.float64]
_PROXIES = Usd.TraverseInstanceProxies(Usd.PrimDefaultPredicate)
# From Z up: what was (x, y, z) is (x, z, -y).
_Y_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])


@dataclass(frozen=True)
class ClockedStage:
    """A stage and its frames.

    Attributes:
        stage: As pxr opens it.
        codes: Time codes of the frames ``(F,)``.
        fps: Time codes a second.
    """

    stage: Any
    codes: Floats
    fps: float

    def at(self, seconds: float) -> float:
        """Return the frame at a time from the first, with its fraction."""
        frame = seconds * self.fps
        require(frame <= len(self.codes) - 1 + 1e-6, f"it ends before {seconds} s")
        return min(frame, float(len(self.codes) - 1))

    def points(self, local: Floats, prim: Any, code: float) -> Floats:
        """Return points of a prim ``(N, 3)`` in the world, in metres with Y up."""
        matrix = np.array(UsdGeom.XformCache(code).GetLocalToWorldTransform(prim))
        return self.turned(np.asarray(local, float) @ matrix[:3, :3] + matrix[3, :3])

    def turned(self, world: Floats) -> Floats:
        """Return points of the stage in metres with Y up."""
        points = world * UsdGeom.GetStageMetersPerUnit(self.stage)
        up = UsdGeom.GetStageUpAxis(self.stage)
        return points @ _Y_UP if up == UsdGeom.Tokens.z else points

    def prims(self, kind: Any, name: str | None = None) -> list[Any]:
        """Return the prims of a kind, of a name or all, prototypes left out."""
        return [
            prim
            for prim in Usd.PrimRange.Stage(self.stage, _PROXIES)
            if prim.IsA(kind)
            and name in (None, prim.GetName())
            and not any(_is_prototype(p) for p in prim.GetPath().GetPrefixes())
        ]


def _is_prototype(path: Any) -> bool:
    return path.name == "Prototypes"


def open_clocked(path: Path, over: Path | None = None) -> ClockedStage:
    """Open a file, or a layer over the rig that it is for.

    The layer has the range, and the rig the units, which they share.
    """
    require(path.suffix in {".usd", ".usda", ".usdc"}, f"{path.name} is not USD")
    layer = Sdf.Layer.FindOrOpen(str(path))
    require(layer, f"{path.name} cannot be opened")
    if over is None:
        stage = Usd.Stage.Open(layer)
    else:
        top = Sdf.Layer.CreateAnonymous(".usda")
        top.subLayerPaths = [str(path), str(over)]
        rig = Sdf.Layer.FindOrOpen(str(over))
        for source in (layer, rig):
            for key in ("metersPerUnit", "upAxis", "timeCodesPerSecond"):
                if source.pseudoRoot.HasInfo(key):
                    top.pseudoRoot.SetInfo(key, source.pseudoRoot.GetInfo(key))
        for key in ("startTimeCode", "endTimeCode", "timeCodesPerSecond"):
            if layer.pseudoRoot.HasInfo(key):
                top.pseudoRoot.SetInfo(key, layer.pseudoRoot.GetInfo(key))
        stage = Usd.Stage.Open(top)
    return ClockedStage(stage, _codes(stage), float(stage.GetTimeCodesPerSecond()))


def sample_codes(stage: Any) -> list[float]:
    """Return the time codes at which anything is sampled."""
    codes: set[float] = set()
    for prim in Usd.PrimRange.Stage(stage, _PROXIES):
        for attribute in prim.GetAttributes():
            codes.update(attribute.GetTimeSamples())
    return sorted(codes)


def _codes(stage: Any) -> Floats:
    if stage.HasAuthoredTimeCodeRange():
        first, last = stage.GetStartTimeCode(), stage.GetEndTimeCode()
    else:
        samples = sample_codes(stage) or [0.0]
        first, last = samples[0], samples[-1]
    return first + np.arange(round(last - first) + 1)


@dataclass(frozen=True)
class PosedSkeleton:
    """A skeleton on a stage."""

    clocked: ClockedStage
    prim: Any
    query: Any

    @cached_property
    def names(self) -> list[str]:
        """Names of its joints, the last of each path."""
        return [str(joint).rsplit("/", 1)[-1] for joint in self.query.GetJointOrder()]

    def index(self, joint: str) -> int:
        """Return the number of a joint."""
        require(joint in self.names, f"no joint {joint!r} among {self.names}")
        return self.names.index(joint)

    def world(self, codes: Floats) -> Floats:
        """Return the places of all joints ``(F, J, 3)`` [m]."""
        frames = []
        for code in np.asarray(codes, float):
            local = np.array(self.query.ComputeJointSkelTransforms(code))[:, 3, :3]
            frames.append(self.clocked.points(local, self.prim, code))
        return np.stack(frames)

    def positions(self) -> Floats:
        """Return the places of all joints in every frame ``(F, J, 3)`` [m]."""
        return self.world(self.clocked.codes)

    def rotations(self) -> Floats:
        """Return how joints are turned against their parents, wxyz ``(F, J, 4)``."""
        require(self.query.GetAnimQuery(), "no animation is bound")
        frames = []
        for code in self.clocked.codes:
            transforms = self.query.ComputeJointLocalTransforms(float(code))
            turns = [m.RemoveScaleShear().ExtractRotationQuat() for m in transforms]
            frames.append([[q.GetReal(), *q.GetImaginary()] for q in turns])
        rotations = np.array(frames)
        return rotations / np.linalg.norm(rotations, axis=2, keepdims=True)


def skeletons(path: Path, over: Path | None = None) -> list[PosedSkeleton]:
    """Return the skeletons of a file, of which there is at least one."""
    clocked = open_clocked(path, over)
    found = [*_skeletons(clocked)]
    require(found, f"{path.name} has no skeleton")
    return found


def _skeletons(clocked: ClockedStage) -> Iterator[PosedSkeleton]:
    for root in clocked.prims(UsdSkel.Root):
        cache = UsdSkel.Cache()
        cache.Populate(UsdSkel.Root(root), _PROXIES)
        for prim in Usd.PrimRange(root, _PROXIES):
            if prim.IsA(UsdSkel.Skeleton):
                query = cache.GetSkelQuery(UsdSkel.Skeleton(prim))
                require(query, f"{prim.GetPath()} is not a skeleton that pxr reads")
                yield PosedSkeleton(clocked, prim, query)


def skeleton_with(path: Path, joint: str, over: Path | None = None) -> PosedSkeleton:
    """Return the first skeleton that has a joint."""
    found = skeletons(path, over)
    having = [each for each in found if joint in each.names]
    require(having, f"no joint {joint!r} among {found[0].names}")
    return having[0]
