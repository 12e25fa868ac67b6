"""Skeletons: joints, their coordinates, and forward kinematics."""
