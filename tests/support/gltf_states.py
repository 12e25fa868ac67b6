"""States of glTF files: what another evaluator expects, and what animtool has."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from animtool.formats.characters.choice import choose_character
from animtool.formats.gltf.animations import Animation
from animtool.formats.gltf.document import Gltf, open_gltf
from animtool.formats.gltf.rig import GltfRig, build_rig
from animtool.formats.gltf.sampling import build_sampler
from animtool.formats.gltf.surfaces import mesh_names, shared_vertices
from animtool.motion.motion import Motion
from animtool.rig.kinematics import WorldTransforms, bind_matrices, forward_kinematics
from animtool.rig.skeleton import Rig
from animtool.rig.surfaces import surfaces_of
from animtool.skin.character import CharacterMesh, character_meshes
from animtool.skin.deform import deform


def skinned_meshes(rig: Rig) -> dict[str, CharacterMesh]:
    """Return the meshes of a rig by name, ready to follow its joints."""
    shapes = [shape.name for shape in rig.shapes]
    bind = bind_matrices(rig)
    meshes = character_meshes(surfaces_of(rig), rig.names, bind, shapes)
    return {one.name: one for one in meshes}


@dataclass
class Character:
    """The whole of a file as a rig, ready to be posed."""

    gltf: Gltf
    made: GltfRig
    meshes: dict[str, CharacterMesh]
    names: dict[int, str]  # of the meshes, by node

    @classmethod
    def of(cls, path: Path) -> Character:
        """Open a file."""
        gltf = open_gltf(path)
        character, _ = choose_character(gltf, "/", "GLT014", "GLT109")
        made = build_rig(gltf, character, "whole")
        nodes = [node for node in character.nodes if gltf.nodes[node].mesh >= 0]
        names = mesh_names(gltf, nodes)
        return cls(gltf, made, skinned_meshes(made.rig), names)


@dataclass
class Apart:
    """Largest differences from what is expected, of lengths by the size of the file."""

    position: float = 0.0
    matrix: float = 0.0
    point: float = 0.0
    weight: float = 0.0
    seen: dict[str, int] = field(default_factory=dict)  # how much was compared

    def add(self, name: str, apart: Any) -> None:
        """Note a difference."""
        largest = float(np.abs(apart).max(initial=0.0))
        setattr(self, name, max(getattr(self, name), largest))
        self.seen[name] = self.seen.get(name, 0) + 1


def compare(character: Character, expected: dict[str, Any], apart: Apart) -> None:
    """Compare a file with its expected states, at rest and in every clip."""
    rest = {"times_s": [0.0], "at": [expected["rest"]]}
    clips: list[tuple[Animation | None, dict[str, Any]]] = [(None, rest)]
    clips += zip(character.gltf.animations, expected["clips"], strict=True)
    for animation, clip in clips:
        moving = build_sampler(character.gltf, character.made, animation)
        motion = moving.sample(np.array(clip["times_s"], np.float64))
        world = forward_kinematics(character.made.rig, *motion.dense())
        for k, state in enumerate(clip["at"]):
            _state(character, expected, state, motion.select(slice(k, k + 1)), apart)
            _places(character, expected, state, world, k, apart)


def _places(
    character: Character,
    expected: dict[str, Any],
    state: dict[str, Any],
    world: WorldTransforms,
    k: int,
    apart: Apart,
) -> None:
    size = expected["size"] or 1.0
    made = character.made
    for node, joint in enumerate(made.joint_of_node.tolist()):
        if joint < 0:
            continue
        own = world.positions[k, joint] - state["positions"][node]
        apart.add("position", own / size)
        if state.get("matrices"):
            rows = np.array(state["matrices"][node]).reshape(3, 4)[:, :3]
            scaled = world.linear[k, joint] * made.baked_scales[node]
            apart.add("matrix", (scaled - rows) / max(1.0, float(np.abs(rows).max())))


def _state(
    character: Character,
    expected: dict[str, Any],
    state: dict[str, Any],
    motion: Motion,
    apart: Apart,
) -> None:
    made, size = character.made, expected["size"] or 1.0
    weights = None if motion.weights is None else motion.weights.dense()[:, :, 0]
    for node, values in (state.get("weights") or {}).items():
        rows = [r for r, (own, _) in enumerate(made.shape_sources) if own == int(node)]
        assert len(rows) == len(values)
        assert weights is not None
        apart.add("weight", weights[0, rows] - values)
    world = forward_kinematics(made.rig, *motion.dense())
    posed: dict[str, npt.NDArray[np.float64]] = {}
    ids = expected["point_ids"] if state.get("points") else ()
    for (node, _, primitive, vertex), point in zip(ids, state["points"], strict=True):
        name = character.names[node]
        mesh = character.meshes.get(name)
        if mesh is None or point is None:
            # Of points and lines, which a rig does not hold.
            continue
        if name not in posed:
            own = mesh.weights(weights)
            posed[name] = deform(mesh.mesh, own, world).points[0]
        at = _vertex_offset(character.gltf, node, primitive) + vertex
        apart.add("point", (posed[name][at] - point) / size)


def _vertex_offset(gltf: Gltf, node: int, primitive: int) -> int:
    """Return the offset of a primitive's vertices in the mesh of a node."""
    key = gltf.meshes[gltf.nodes[node].mesh].primitives[primitive].vertex_key
    vertex_sets = shared_vertices(gltf, node)
    return next(v.first_vertex for v in vertex_sets if v.primitive.vertex_key == key)
