"""Small files with known content, for checks to read."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from pxr import Gf, Sdf, Usd, UsdGeom, UsdSkel, Vt

from support.c3d_bytes import C3dFile, words

Floats = npt.NDArray[np.float64]
FPS = 24.0


def made_trc(
    points: npt.ArrayLike,
    names: Sequence[str],
    *,
    rate: float = 60.0,
    seconds: npt.ArrayLike | None = None,
    closed: bool = True,
) -> str:
    """Return the text of a TRC of points ``(F, M, 3)`` in millimetres.

    NaN is an empty cell; `closed` says whether a tab ends a row.
    """
    rows = np.asarray(points, float)
    times = np.arange(len(rows)) / rate if seconds is None else np.asarray(seconds)
    lines = [
        "PathFileType\t4\t(X/Y/Z)\tmade.trc",
        "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits",
        f"{rate:g}\t{rate:g}\t{len(rows)}\t{len(names)}\tmm",
        "Frame#\tTime\t" + "\t\t\t".join(names) + "\t\t",
        "\t\t" + "\t".join(f"{a}{i}" for i in range(1, len(names) + 1) for a in "XYZ"),
        "",
    ]
    for i, row in enumerate(rows):
        cells = ["" if np.isnan(x) else f"{x:.4f}" for x in row.ravel()]
        end = "\t" if closed else ""
        lines.append("\t".join([str(i + 1), f"{times[i]:.5f}", *cells]) + end)
    return "\n".join(lines) + "\n"


def made_c3d(points: npt.ArrayLike, *, a_frame: int, analog_rate: float) -> bytes:
    """Return a C3D in millimetres at 120 Hz, with word 10 and ANALOG:RATE."""
    rate = np.array([analog_rate], np.float32)
    names = [f"M{i}" for i in range(np.shape(points)[1])]
    file = C3dFile(np.asarray(points, float), names, groups={"ANALOG": {"RATE": rate}})
    data = bytearray(file.build())
    data[18:20] = words([a_frame])
    return bytes(data)


def new_stage(path: Path, frames: int, *, up: str = "Y", unit: float = 1.0) -> Any:
    """Return a stage with a range that begins at 1."""
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageUpAxis(stage, up)
    UsdGeom.SetStageMetersPerUnit(stage, unit)
    stage.SetTimeCodesPerSecond(FPS)
    stage.SetStartTimeCode(1)
    stage.SetEndTimeCode(frames)
    return stage


def made_skeleton(
    path: Path,
    names: Sequence[str],
    translations: npt.ArrayLike,
    *,
    turns: npt.ArrayLike | None = None,
    up: str = "Y",
    unit: float = 1.0,
    mesh: bool = False,
    extent: npt.ArrayLike | None = None,
    begin: float = 1.0,
) -> None:
    """Write a chain of joints.

    Args:
        path: The stage.
        names: Of its joints, from the root down.
        translations: Against the parents ``(F, J, 3)`` in units of the stage.
        turns: About z ``(F, J)`` [deg].
        up: Axis of the stage.
        unit: Metres.
        mesh: Whether a triangle hangs on the last joint.
        extent: Of the SkelRoot.
        begin: Time code of the first sample.
    """
    moves = np.asarray(translations, float)
    frames, joints = moves.shape[:2]
    angles = np.zeros((frames, joints)) if turns is None else np.asarray(turns, float)
    stage = new_stage(path, frames, up=up, unit=unit)
    root = UsdSkel.Root.Define(stage, "/hero")
    skeleton = UsdSkel.Skeleton.Define(stage, "/hero/rig")
    paths = ["/".join(names[: i + 1]) for i in range(joints)]
    rest = Vt.Matrix4dArray([Gf.Matrix4d(1)] * joints)
    skeleton.CreateJointsAttr(paths)
    skeleton.CreateRestTransformsAttr(rest)
    skeleton.CreateBindTransformsAttr(rest)
    anim = UsdSkel.Animation.Define(stage, "/hero/anim")
    anim.CreateJointsAttr(paths)
    anim.CreateScalesAttr(Vt.Vec3hArray([Gf.Vec3h(1)] * joints))
    for i in range(frames):
        halves = np.radians(angles[i]) / 2
        quats = [Gf.Quatf(np.cos(h), Gf.Vec3f(0, 0, np.sin(h))) for h in halves]
        rows = [Gf.Vec3f(*map(float, row)) for row in moves[i]]
        anim.CreateTranslationsAttr().Set(Vt.Vec3fArray(rows), begin + i)
        anim.CreateRotationsAttr().Set(Vt.QuatfArray(quats), begin + i)
    binding = UsdSkel.BindingAPI.Apply(skeleton.GetPrim())
    binding.CreateAnimationSourceRel().SetTargets(["/hero/anim"])
    if extent is not None:
        ends = [Gf.Vec3f(*map(float, end)) for end in np.asarray(extent)]
        root.CreateExtentAttr(Vt.Vec3fArray(ends))
    if mesh:
        _skinned_triangle(stage, joints - 1)
    stage.Save()


def _skinned_triangle(stage: Any, joint: int) -> None:
    """Add a triangle of side 1 in x and y that follows one joint."""
    mesh = UsdGeom.Mesh.Define(stage, "/hero/body")
    points = [Gf.Vec3f(0, 0, 0), Gf.Vec3f(1, 0, 0), Gf.Vec3f(0, 1, 0)]
    mesh.CreatePointsAttr(Vt.Vec3fArray(points))
    mesh.CreateFaceVertexCountsAttr([3])
    mesh.CreateFaceVertexIndicesAttr([0, 1, 2])
    binding = UsdSkel.BindingAPI.Apply(mesh.GetPrim())
    binding.CreateJointIndicesPrimvar(False, 1).Set(Vt.IntArray([joint] * 3))
    binding.CreateJointWeightsPrimvar(False, 1).Set(Vt.FloatArray([1.0] * 3))
    binding.CreateSkeletonRel().SetTargets(["/hero/rig"])


def made_bodies(
    path: Path, centres: npt.ArrayLike, *, turns: npt.ArrayLike | None = None
) -> None:
    """Write instances ``(F, N, 3)`` [m], turned about z ``(F, N)`` [deg]."""
    places = np.asarray(centres, float)
    frames, count = places.shape[:2]
    angles = np.zeros((frames, count)) if turns is None else np.asarray(turns, float)
    stage = new_stage(path, frames)
    instancer = UsdGeom.PointInstancer.Define(stage, "/scene/blocks")
    instancer.CreateIdsAttr(Vt.Int64Array(range(count)))
    full = instancer.GetPrim().CreateAttribute(
        "orientationsf", Sdf.ValueTypeNames.QuatfArray
    )
    for i in range(frames):
        halves = np.radians(angles[i]) / 2
        quats = [Gf.Quatf(np.cos(h), Gf.Vec3f(0, 0, np.sin(h))) for h in halves]
        instancer.CreatePositionsAttr().Set(_vectors(places[i]), i + 1)
        full.Set(Vt.QuatfArray(quats), i + 1)
    stage.Save()


def made_points(path: Path, points: npt.ArrayLike) -> None:
    """Write particles ``(F, N, 3)`` [m]."""
    places = np.asarray(points, float)
    stage = new_stage(path, len(places))
    prim = UsdGeom.Points.Define(stage, "/scene/dust")
    prim.CreateIdsAttr(Vt.Int64Array(range(places.shape[1])))
    for i, row in enumerate(places):
        prim.CreatePointsAttr().Set(_vectors(row), i + 1)
    stage.Save()


def made_rope(path: Path, points: npt.ArrayLike) -> None:
    """Write one curve through points ``(F, N, 3)`` [m]."""
    places = np.asarray(points, float)
    stage = new_stage(path, len(places))
    curve = UsdGeom.BasisCurves.Define(stage, "/scene/cord")
    curve.CreateTypeAttr("linear")
    curve.CreateCurveVertexCountsAttr([places.shape[1]])
    for i, row in enumerate(places):
        curve.CreatePointsAttr().Set(_vectors(row), i + 1)
    stage.Save()


def sheet(side: int, height: float = 0.0) -> Floats:
    """Return points of a level square of 1 m about the origin ``(side², 3)``."""
    line = np.linspace(-0.5, 0.5, side)
    x, z = np.meshgrid(line, line)
    return np.stack([x.ravel(), np.full(side**2, height), z.ravel()], axis=1)


def made_cloth(path: Path, points: npt.ArrayLike) -> None:
    """Write a square grid of points ``(F, side², 3)`` [m] with quads."""
    places = np.asarray(points, float)
    side = round(places.shape[1] ** 0.5)
    corners = [
        (k, k + 1, k + side + 1, k + side)
        for i in range(side - 1)
        for k in range(i * side, i * side + side - 1)
    ]
    stage = new_stage(path, len(places))
    mesh = UsdGeom.Mesh.Define(stage, "/scene/net")
    mesh.CreateFaceVertexCountsAttr([4] * len(corners))
    mesh.CreateFaceVertexIndicesAttr([k for face in corners for k in face])
    for i, row in enumerate(places):
        mesh.CreatePointsAttr().Set(_vectors(row), i + 1)
    stage.Save()


def _vectors(rows: Floats) -> Any:
    return Vt.Vec3fArray([Gf.Vec3f(*map(float, row)) for row in rows])
