"""Frames as prims, with the named arrays that they bring."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.testing import assert_array_equal
from pxr import Sdf, Usd

from animtool.frames import CurvesFrame, Frame, MeshFrame, PointsFrame
from animtool.usd.point_based import FrameWriter

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
FRAMES: list[Frame] = [
    PointsFrame(np.array([7, 8, 9]), POINTS, POINTS, np.full(3, 0.5), PRIMVARS),
    CurvesFrame(POINTS, POINTS, np.array([3]), 0.5, primvars=PRIMVARS),
    MeshFrame(POINTS, POINTS, np.array([3]), np.arange(3), primvars=PRIMVARS),
]


def test_named_arrays_of_every_frame_are_sampled_primvars() -> None:
    for frame in FRAMES:
        layer = Sdf.Layer.CreateAnonymous(".usda")
        writer = FrameWriter("/it", 0.01)
        writer.begin(layer, frame)
        writer.write(layer, 1.0, writer.values(1.0, frame)[0])
        other = {name: values + 1 for name, values in PRIMVARS.items()}
        changed = replace(frame, primvars=other)
        writer.write(layer, 2.0, writer.values(2.0, changed)[0])
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
        assert_array_equal(np.array(prim.GetAttribute("points").Get(1.0)), POINTS * 100)
