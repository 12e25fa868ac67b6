"""A placed character of three joints, and where pxr has it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt
from pxr import Usd, UsdGeom, UsdSkel

from support.usd import joint_positions

Floats = npt.NDArray[np.float64]

FRAMES = 5
CODES = np.arange(1.0, FRAMES + 1)
STAGE = """#usda 1.0
(
    defaultPrim = "set"
    startTimeCode = 1
    endTimeCode = {last}
    metersPerUnit = {unit}
    upAxis = "{up}"
    timeCodesPerSecond = {fps}
)
def Xform "set"
{{
{set}
    def SkelRoot "char"
    {{
{char}
        def Skeleton "skel" (prepend apiSchemas = ["SkelBindingAPI"])
        {{
{skel}
            uniform token[] joints = ["Hips", "Hips/Spine", "Hips/Spine/Head"]
            uniform matrix4d[] bindTransforms = [{bind}]
            uniform matrix4d[] restTransforms = [{rest}]
            rel skel:animationSource = </set/char/anim>
        }}
        def SkelAnimation "anim"
        {{
            uniform token[] joints = ["Hips", "Hips/Spine", "Hips/Spine/Head"]
            float3[] translations.timeSamples = {{ {moves} }}
            quatf[] rotations.timeSamples = {{ {turns} }}
            half3[] scales = [(1, 1, 1), (1, 1, 1), (1, 1, 1)]
        }}
        def Mesh "body" (prepend apiSchemas = ["SkelBindingAPI"])
        {{
            int[] faceVertexCounts = [3, 3]
            int[] faceVertexIndices = [0, 1, 2, 1, 3, 2]
            point3f[] points = [{points}]
            int[] primvars:skel:jointIndices = [0, 1, 1, 2, 2, 1, 0, 2] (
                elementSize = 2
                interpolation = "vertex"
            )
            float[] primvars:skel:jointWeights = [.7, .3, .5, .5, .9, .1, .4, .6] (
                elementSize = 2
                interpolation = "vertex"
            )
            rel skel:skeleton = </set/char/skel>
            uniform token subdivisionScheme = "none"
        }}
    }}
}}
"""


def stage_text(
    where: str = "",
    ops: str = "",
    *,
    up: str = "Y",
    unit: float = 0.01,
    fps: int = 24,
    size: float = 1.0,
) -> str:
    """Return a stage of a leg of .9 m, with transforms on one of its prims."""
    long = 0.01 / unit / size

    def vector(x: float, y: float, z: float) -> str:
        # Up is the stage's axis.
        y, z = (y, z) if up == "Y" else (-z, y)
        return f"({x * long:.9g}, {y * long:.9g}, {z * long:.9g})"

    def matrix(x: float, y: float, z: float) -> str:
        rows = "(1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0)"
        return f"({rows}, {vector(x, y, z)[:-1]}, 1))"

    moves, turns = [], []
    for i, code in enumerate(CODES):
        places = vector(2 * i, 90, i), vector(1, -40, 2), vector(0, -40, 1)
        moves.append(f"{code:g}: [{', '.join(places)}]")
        half = np.radians(6.0 * i)
        x, y, z = np.sin(half) * np.array([0.6, 0.0, 0.8])
        turn = f"({np.cos(half):.9g}, {x:.9g}, {y:.9g}, {z:.9g})"
        turns.append(f"{code:g}: [{turn}, {turn}, (1, 0, 0, 0)]")
    rest = [(0, 90, 0), (1, -40, 2), (0, -40, 1)]
    bind = np.cumsum(rest, axis=0).tolist()
    points = [(5, 85, 3), (6, 50, -4), (-5, 45, 6), (2, 8, 9)]
    texts = {"set": "", "char": "", "skel": ""} | ({where: ops} if where else {})
    return STAGE.format(
        last=FRAMES,
        unit=unit,
        up=up,
        fps=fps,
        bind=", ".join(matrix(*row) for row in bind),
        rest=", ".join(matrix(*row) for row in rest),
        moves=", ".join(moves),
        turns=", ".join(turns),
        points=", ".join(vector(*row) for row in points),
        **texts,
    )


def op_text(kind: str, moves: bool, unit: float) -> str:
    """Return operations of a prim: placed 3 m away, turned, half its size, or all."""
    metre = 1.0 / unit

    def op(spelled: str, name: str, one: object, other: object) -> str:
        value = f" = {one}"
        if moves:
            value = f".timeSamples = {{ 1: {one}, {FRAMES}: {other} }}"
        return f"{spelled} xformOp:{name}{value}\n"

    kinds = {
        "translate": op(
            "double3", "translate", (3 * metre, metre, 0), (metre, 0, 2 * metre)
        ),
        "rotate": op("float3", "rotateXYZ", (90, 20, 10), (70, 50, -10)),
        "scale": op("float3", "scale", (0.5, 0.5, 0.5), (0.75, 0.75, 0.75)),
    }
    chosen = list(kinds) if kind == "all" else [kind]
    names = {"rotate": "rotateXYZ"}
    order = ", ".join(f'"xformOp:{names.get(one, one)}"' for one in chosen)
    text = "".join(kinds[one] for one in chosen)
    return f"{text}uniform token[] xformOpOrder = [{order}]"


def composed(path: Path | Usd.Stage, codes: Floats = CODES) -> Floats:
    """Return joints where pxr has them ``(F, J, 3)`` [m], Y up."""
    stage = Usd.Stage.Open(str(path)) if isinstance(path, Path) else path
    places = joint_positions(stage, codes) * UsdGeom.GetStageMetersPerUnit(stage)
    return upright(places, UsdGeom.GetStageUpAxis(stage))


def upright(places: Floats, up: str) -> Floats:
    if up == "Y":
        return places
    return np.stack([places[..., 0], places[..., 2], -places[..., 1]], axis=-1)


def skinned(path: Path) -> Floats:
    """Return points where pxr skins them ``(F, V, 3)`` [m], Y up."""
    stage = Usd.Stage.Open(str(path))
    root = UsdSkel.Root(stage.GetPrimAtPath("/set/char"))
    UsdSkel.BakeSkinning(root)
    return points_of(stage)


def points_of(stage: Usd.Stage) -> Floats:
    prim = next(p for p in stage.Traverse() if p.GetName() == "body")
    rows = []
    for code in CODES:
        points = np.array(UsdGeom.Mesh(prim).GetPointsAttr().Get(code), float)
        cache = UsdGeom.XformCache(code)
        world = np.array(cache.GetLocalToWorldTransform(prim))
        rows.append(points @ world[:3, :3] + world[3, :3])
    places = np.array(rows) * UsdGeom.GetStageMetersPerUnit(stage)
    return upright(places, UsdGeom.GetStageUpAxis(stage))


def over(layer: Path, rig: Path) -> Usd.Stage:
    """Return a layer over its rig."""
    stage = Usd.Stage.CreateInMemory()
    stage.GetRootLayer().subLayerPaths = [str(layer), str(rig)]
    below = Usd.Stage.Open(str(rig))
    UsdGeom.SetStageUpAxis(stage, UsdGeom.GetStageUpAxis(below))
    UsdGeom.SetStageMetersPerUnit(stage, UsdGeom.GetStageMetersPerUnit(below))
    stage.SetTimeCodesPerSecond(below.GetTimeCodesPerSecond())
    return stage


PLACES = ("set", "char", "skel")
