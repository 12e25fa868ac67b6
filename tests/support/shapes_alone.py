"""Characters of blend shapes alone, and others that exporters write."""

from __future__ import annotations

from pathlib import Path

__all__ = ["NORMALS_ONLY", "write_face", "write_still"]

# A shape that turns normals and moves no point.
NORMALS_ONLY = "crease"

# One shape moves two points, the other turns normals alone; a Skeleton without joints.
_FACE = """#usda 1.0
(
    defaultPrim = "Face"
    startTimeCode = 1
    endTimeCode = 3
    framesPerSecond = 24
    timeCodesPerSecond = 24
    metersPerUnit = 0.01
    upAxis = "Y"
)
def SkelRoot "Face" (prepend apiSchemas = ["SkelBindingAPI"])
{
    float3[] extent = [(-1, 0, 0), (1, 2.5, 0)]
    rel skel:skeleton = </Face/Skel>
    def Mesh "Head" (prepend apiSchemas = ["SkelBindingAPI"])
    {
        float3[] extent = [(-1, 0, 0), (1, 2, 0)]
        int[] faceVertexCounts = [4]
        int[] faceVertexIndices = [0, 1, 2, 3]
        normal3f[] normals = [(0, 0, 1), (0, 0, 1), (0, 0, 1), (0, 0, 1)]
        point3f[] points = [(-1, 0, 0), (1, 0, 0), (1, 2, 0), (-1, 2, 0)]
        uniform token[] skel:blendShapes = ["smile", "crease"]
        rel skel:blendShapeTargets = [</Face/Head/smile>, </Face/Head/crease>]
        uniform token subdivisionScheme = "none"
        def BlendShape "smile"
        {
            uniform vector3f[] offsets = [(0, 0.5, 0), (0, 0.25, 0)]
            uniform int[] pointIndices = [2, 3]
        }
        def BlendShape "crease"
        {
            uniform vector3f[] normalOffsets = [(0.5, 0, 0), (-0.5, 0, 0)]
            uniform int[] pointIndices = [0, 1]
        }
    }
    def Skeleton "Skel" (prepend apiSchemas = ["SkelBindingAPI"])
    {
        rel skel:animationSource = </Face/Skel/Anim>
        def SkelAnimation "Anim"
        {
            uniform token[] blendShapes = ["smile", "crease"]
            float[] blendShapeWeights.timeSamples = {
                1: [0, 0],
                2: [0.5, 0.25],
                3: [1.25, 0.75],
            }
        }
    }
}
"""
# A dual-quaternion skin whose SkelAnimation names joints and has no value for any.
_STILL = """#usda 1.0
(
    defaultPrim = "Root"
    startTimeCode = 1
    endTimeCode = 5
    framesPerSecond = 24
    timeCodesPerSecond = 24
    metersPerUnit = 0.01
    upAxis = "Y"
)
def SkelRoot "Root" (prepend apiSchemas = ["SkelBindingAPI"])
{
    float3[] extent = [(-1, -1, -1), (1, 3, 1)]
    rel skel:animationSource = </Root/Animation>
    rel skel:skeleton = </Root/Skeleton>
    def Skeleton "Skeleton"
    {
        uniform token[] joints = ["low", "low/high"]
        uniform matrix4d[] bindTransforms = [
            ((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1)),
            ((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 2, 0, 1))]
        uniform matrix4d[] restTransforms = [
            ((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1)),
            ((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 2, 0, 1))]
    }
    def SkelAnimation "Animation"
    {
        uniform token[] joints = ["low", "low/high"]
    }
    def Mesh "Post" (prepend apiSchemas = ["SkelBindingAPI"])
    {
        float3[] extent = [(-1, 0, 0), (1, 3, 0)]
        int[] faceVertexCounts = [4]
        int[] faceVertexIndices = [0, 1, 2, 3]
        point3f[] points = [(-1, 0, 0), (1, 0, 0), (1, 3, 0), (-1, 3, 0)]
        int[] primvars:skel:jointIndices = [0, 1, 0, 1, 0, 1, 0, 1] (
            elementSize = 2
            interpolation = "vertex"
        )
        float[] primvars:skel:jointWeights = [1, 0, 1, 0, 0, 1, 0, 1] (
            elementSize = 2
            interpolation = "vertex"
        )
        uniform token primvars:skel:skinningMethod = "dualQuaternion"
        uniform token subdivisionScheme = "none"
    }
}
"""


def write_face(folder: Path) -> Path:
    """Write a character of two blend shapes, and no joints."""
    path = folder / "face.usda"
    path.write_text(_FACE, "utf-8")
    return path


def write_still(folder: Path) -> Path:
    """Write a character whose animation only names its joints."""
    path = folder / "still.usda"
    path.write_text(_STILL, "utf-8")
    return path
