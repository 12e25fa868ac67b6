"""MJCF, the models of MuJoCo: bodies and their joints as a rig.

References:
    MuJoCo documentation, ``XML reference`` and ``Computation: kinematics``.
"""
