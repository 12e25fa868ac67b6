"""What URDF and MJCF share: XML, names, mass, colliders, and the rig of a robot."""
