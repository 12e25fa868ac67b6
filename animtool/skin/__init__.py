"""How meshes follow a rig: blend shapes, linear blend and dual quaternion skinning."""
