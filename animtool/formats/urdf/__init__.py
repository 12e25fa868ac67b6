"""URDF, the robot descriptions of ROS: links and joints as a rig.

References:
    ROS, ``urdf/XML`` (wiki.ros.org/urdf/XML): robot, link, joint.
"""
