"""Rows of ``$ANIMTOOL_DATA/reported`` and what they ask of results.

What a result holds is read apart from animtool: USD by pxr, BVH, TRC and C3D by plain
readers of the tests, all else from what the command says.
"""
