"""Mesh deformation: blend shapes, linear blend and dual quaternion skinning."""
