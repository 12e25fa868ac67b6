"""MJCF (MuJoCo models): bodies and joints as a rig.

References:
    MuJoCo documentation, ``XML reference`` and ``Computation: kinematics``.
"""
