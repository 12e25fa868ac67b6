"""Writes and reads bodies, joints and colliders as UsdPhysics."""
