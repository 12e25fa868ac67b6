"""The skins of characters in motion."""

from __future__ import annotations

import numpy as np

from animtool.motion.motion import Motion
from animtool.rig.kinematics import bind_world, forward_kinematics
from animtool.rig.skeleton import Rig
from animtool.rig.surfaces import surfaces_of
from animtool.sim.colliders.on_joints import JointCapsules
from animtool.skin.character import character_meshes
from animtool.skin.deform import deform
from animtool.systems.attach.colliders import capsule_distances

from .skins import Array, of_world


def skin_of(rig: Rig, motion: Motion, name: str) -> tuple[Array, Array]:
    """Return points of a mesh and its normals, in each frame ``(F, V, 3)``."""
    (surface,) = [one for one in surfaces_of(rig) if one.name == name]
    (mesh,) = character_meshes([surface], rig.names, of_world(bind_world(rig))[0], [])
    points = deform(mesh.mesh, None, forward_kinematics(rig, *motion.dense())).points
    corners = points[:, surface.indices.reshape(-1, 4)]
    across = np.cross(
        corners[:, :, 2] - corners[:, :, 0], corners[:, :, 3] - corners[:, :, 1]
    )
    normals = np.zeros_like(points)
    for frame, faces in zip(normals, across, strict=True):
        np.add.at(frame, surface.indices, np.repeat(faces, 4, axis=0))
    return points, normals / np.linalg.norm(normals, axis=-1, keepdims=True)


def out_of_skin(points: Array, skin: Array, normals: Array) -> Array:
    """Return how far points ``(N, 3)`` are outside a skin ``(V, 3)``, near to it [m].

    Of several near points of the skin, the one most in front counts.
    """
    from scipy.spatial import cKDTree

    apart, near = cKDTree(skin).query(points, 4)
    ahead = np.einsum("nkj,nkj->nk", points[:, None] - skin[near], normals[near])
    return np.where(apart < 0.06, ahead, apart).max(axis=1)


def out_of_capsules(rig: Rig, motion: Motion, points: Array) -> Array:
    """Return how far points ``(F, N, 3)`` are outside the rig's capsules [m]."""
    capsules = JointCapsules.from_rig(rig)
    placed = capsules.world_ends(forward_kinematics(rig, *motion.dense()))
    radii = capsules.radii.tolist()
    return np.array(
        [
            np.min(
                [
                    capsule_distances(row, e, r)
                    for e, r in zip(ends, radii, strict=True)
                ],
                0,
            )
            for row, ends in zip(points, placed, strict=True)
        ]
    )
