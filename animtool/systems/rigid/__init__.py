"""Rigid body dynamics: contacts, stacks, joints, ragdolls."""
