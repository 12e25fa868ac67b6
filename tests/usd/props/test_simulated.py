"""Frames as prims, with the named arrays that they bring."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from pxr import Sdf, Usd, UsdGeom
from support.faults import raises

from animtool.core.errors import OutputError
from animtool.maths import so3
from animtool.motion.frames import (
    CurvesFrame,
    Frame,
    MeshFrame,
    PointsFrame,
    TransformsFrame,
)
from animtool.usd.caches.writer import PointWriter
from animtool.usd.props.simulated import SimulatedPrim

POINTS = np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0], [7.0, 8.0, 10.0]])
PRIMVARS = {
    "heat": np.array([0.5, 1.5, 2.5]),
    "species": np.array([3, 1, 2]),
    "spin": POINTS + 0.25,
    "displayColor": POINTS / 10,
}
TYPES = {
    "heat": Sdf.ValueTypeNames.FloatArray,
    "species": Sdf.ValueTypeNames.IntArray,
    "spin": Sdf.ValueTypeNames.Float3Array,
    "displayColor": Sdf.ValueTypeNames.Color3fArray,
}
TRIANGLE = MeshFrame(POINTS, POINTS, np.array([3]), np.arange(3))
TURNS = so3.normalize(np.array([[0.5, 0, 0, 1], [0, -2, 0, 1], [1, 2, 3, -4.0]]))
COPIES = TransformsFrame(
    np.array([7, 8, 9]),
    POINTS,
    POINTS,
    TURNS,
    np.radians(POINTS),
    np.array([[1, 1, 1], [2, 1, 1], [0.5, 0.25, 3]]),
    np.array([1, 0, 1]),
    (TRIANGLE, replace(TRIANGLE, points=-POINTS)),
    PRIMVARS,
)
ROWS = ("ids", "points", "velocities", "rotations", "spins", "scales", "mesh_indices")
FRAMES: list[Frame] = [
    COPIES,
    PointsFrame(np.array([7, 8, 9]), POINTS, POINTS, np.full(3, 0.5), PRIMVARS),
    CurvesFrame(POINTS, POINTS, np.array([3]), 0.5, primvars=PRIMVARS),
    MeshFrame(POINTS, POINTS, np.array([3]), np.arange(3), primvars=PRIMVARS),
]


def test_named_arrays_of_every_frame_are_sampled_primvars() -> None:
    for frame in FRAMES:
        layer = Sdf.Layer.CreateAnonymous(".usda")
        simulated = SimulatedPrim("/it", 0.01)
        simulated.author_prim(layer, frame)
        writer = PointWriter(layer, simulated.report, writes_every_frame=True)
        writer.add(simulated.build_block(0, 1.0, frame))
        other = {name: values + 1 for name, values in PRIMVARS.items()}
        changed = replace(frame, primvars=other)
        writer.add(simulated.build_block(0, 2.0, changed))
        stage = Usd.Stage.Open(layer)
        prim = stage.GetPrimAtPath("/it")
        for name, values in PRIMVARS.items():
            attribute = prim.GetAttribute(f"primvars:{name}")
            assert attribute.GetTypeName() == TYPES[name]
            assert attribute.GetMetadata("interpolation") == "vertex"
            for code, expected in ((1.0, values), (2.0, other[name])):
                assert_array_equal(
                    np.array(attribute.Get(code)), expected.astype(np.float32)
                )
        name = "positions" if prim.IsA("PointInstancer") else "points"
        assert_array_equal(np.array(prim.GetAttribute(name).Get(1.0)), POINTS * 100)


def test_copies_of_meshes_are_where_they_are_told() -> None:
    layer = Sdf.Layer.CreateAnonymous(".usda")
    simulated, nothing = SimulatedPrim("/it", 0.01), np.arange(0)
    some = {name: values[nothing] for name, values in PRIMVARS.items()}
    empty = replace(
        COPIES, primvars=some, **{n: getattr(COPIES, n)[nothing] for n in ROWS}
    )
    simulated.author_prim(layer, COPIES)
    writer = PointWriter(layer, simulated.report, writes_every_frame=True)
    for code, frame in ((1.0, COPIES), (2.0, empty)):
        writer.add(simulated.build_block(0, code, frame))
    stage = Usd.Stage.Open(layer)
    instancer = UsdGeom.PointInstancer(stage.GetPrimAtPath("/it"))
    found = np.array(instancer.ComputeInstanceTransformsAtTime(1.0, 1.0))
    whole = np.tile(np.eye(4), (3, 1, 1))
    whole[:, :3, :3] = (so3.to_matrix(TURNS) * COPIES.scales[:, None]).swapaxes(1, 2)
    whole[:, 3, :3] = POINTS * 100
    assert_allclose(found, whole, atol=1e-4)
    assert_allclose(np.array(instancer.GetAngularVelocitiesAttr().Get(1.0)), POINTS)
    targets = instancer.GetPrototypesRel().GetTargets()
    meshes = [UsdGeom.Mesh(stage.GetPrimAtPath(path)) for path in targets]
    for mesh, sign in zip(meshes, (1, -1), strict=True):
        assert mesh.GetDoubleSidedAttr().Get()
        assert not mesh.GetVelocitiesAttr().HasAuthoredValue()
        assert_allclose(np.array(mesh.GetPointsAttr().Get()), sign * POINTS * 100)
    # USD's own bounds are of the boxes of all copies too.
    expected = instancer.ComputeExtentAtTime(1.0, 1.0)
    assert_allclose(
        np.array(instancer.GetExtentAttr().Get(1.0)), np.array(expected), rtol=1e-5
    )
    assert len(instancer.GetPositionsAttr().Get(2.0)) == 0


@pytest.mark.parametrize(
    ("names", "which"), [((), "point 1"), (("nut", "bolt", "rod"), "body 'bolt'")]
)
def test_what_is_too_large_is_of_a_body_or_a_point(
    names: tuple[str, ...], which: str
) -> None:
    frame = replace(COPIES, names=names)
    simulated = SimulatedPrim("/it", 1.0)
    simulated.author_prim(Sdf.Layer.CreateAnonymous(".usda"), frame)
    points = POINTS * [[1], [1e39], [1]]
    with raises(OutputError, "USD170", match=f"{which} at frame 2 is 4e"):
        simulated.build_block(0, 2.0, replace(frame, points=points))
