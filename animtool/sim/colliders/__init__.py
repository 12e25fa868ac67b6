"""Colliders: shapes, their poses over time, and collision of particles with them."""

from animtool.sim.colliders.bodies import MovingBodies
from animtool.sim.colliders.collider import Collider, Poses
from animtool.sim.colliders.colliding import (
    Colliders,
    CollisionResult,
    ContactKind,
    Contacts,
    collide,
)
from animtool.sim.colliders.on_joints import joint_poses, rig_colliders
from animtool.sim.colliders.shapes import (
    SHAPES,
    Box,
    Capsule,
    HeightField,
    Mesh,
    Plane,
    Shape,
    Sphere,
)
from animtool.sim.colliders.sheets import Sheet, SheetMotion

__all__ = [
    "SHAPES",
    "Box",
    "Capsule",
    "Collider",
    "Colliders",
    "CollisionResult",
    "ContactKind",
    "Contacts",
    "HeightField",
    "Mesh",
    "MovingBodies",
    "Plane",
    "Poses",
    "Shape",
    "Sheet",
    "SheetMotion",
    "Sphere",
    "collide",
    "joint_poses",
    "rig_colliders",
]
