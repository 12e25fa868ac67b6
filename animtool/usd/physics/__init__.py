"""UsdPhysics: bodies, joints and colliders, written and read."""
