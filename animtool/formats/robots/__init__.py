"""Common parts of URDF and MJCF: XML, names, masses, colliders, rigs."""
