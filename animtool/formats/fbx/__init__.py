"""FBX reader: skeletons, meshes, blend shapes and animation.

References: Autodesk, *FBX SDK documentation*: "Computing transformation matrices",
`FbxAnimCurve`, `FbxAnimLayer`, `FbxCluster`, `FbxBlendShapeChannel`; the layout of
binary files after the Blender Foundation's *FBX binary file format specification*,
2013.
"""
