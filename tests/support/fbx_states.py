"""States of FBX files: what another evaluator expects, and what animtool has."""

from __future__ import annotations

import copy
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from animtool.formats.characters.choice import choose_character
from animtool.formats.fbx.curves import FbxExtrapolation
from animtool.formats.fbx.poses import NodeTransforms
from animtool.formats.fbx.rig import FbxRig, build_rig
from animtool.formats.fbx.sampling import FbxSampler
from animtool.formats.fbx.scene import FbxScene, open_fbx
from animtool.formats.fbx.settings import TICKS_PER_SECOND
from animtool.formats.fbx.takes import AnimTake
from animtool.motion.motion import Motion
from animtool.rig.kinematics import WorldTransforms, forward_kinematics
from animtool.skin.character import CharacterMesh
from animtool.skin.deform import deform
from support.gltf_states import skinned_meshes

Array = npt.NDArray[np.float64]


@dataclass
class Posed:
    """A state of a file."""

    motion: Motion
    world: WorldTransforms


@dataclass
class FbxCharacter:
    """The whole of a file as a rig, ready to be posed."""

    scene: FbxScene
    made: FbxRig
    meshes: dict[str, CharacterMesh]
    _samplers: dict[int, FbxSampler] = field(default_factory=dict)

    @classmethod
    def of(cls, path: Path) -> FbxCharacter:
        """Open a file."""
        scene = open_fbx(path)
        character, _ = choose_character(scene, "/", "FBX014", "FBX115")
        made = build_rig(scene, character, "whole")
        return cls(scene, made, skinned_meshes(made.rig))

    def take(self, name: str | None) -> AnimTake | None:
        """Return a take by its name in the file."""
        takes = self.scene.takes
        return next((take for take in takes if take.name == name), None)

    def pose(self, take: AnimTake | None, seconds: float) -> Posed:
        """Return the state at a time of a take; of None as it was saved."""
        if id(take) not in self._samplers:
            self._samplers[id(take)] = FbxSampler(self.scene, self.made, take)
        ticks = np.array([round(seconds * TICKS_PER_SECOND)], np.int64)
        motion = self._samplers[id(take)].sample(ticks)
        return Posed(motion, forward_kinematics(self.made.rig, *motion.dense()))

    def matrix(self, posed: Posed, node: int) -> Array | None:
        """Return the world matrix of a node in the file's unit and axes ``(3, 4)``."""
        made = self.made
        joint = int(made.joint_of_node[node])
        if joint < 0:
            return None
        back = self.scene.settings.basis.T
        linear = posed.world.linear[0, joint] * made.baked_scales[node]
        place = posed.world.positions[0, joint] / made.rig.meters_per_unit
        return np.concatenate([back @ linear, (back @ place)[:, None]], axis=1)

    def points(self, posed: Posed, node: int) -> Array | None:
        """Return the points of the mesh that a node shows, likewise ``(V, 3)``."""
        mesh = self.meshes.get(self.made.mesh_names.get(node, ""))
        if mesh is None:
            return None
        weights = posed.motion.weights
        values = None if weights is None else weights.dense()[:, :, 0]
        own = deform(mesh.mesh, mesh.weights(values), posed.world).points[0]
        unit = self.made.rig.meters_per_unit
        return np.asarray(own @ self.scene.settings.basis) / unit

    def paths(self) -> dict[str, list[int]]:
        """Return the nodes by their names and those of all above."""
        models = self.scene.models
        return by_path([m.name for m in models], [m.parent for m in models])


def by_path(names: list[str], parents: list[int]) -> dict[str, list[int]]:
    """Return indices by the path of names from the root."""
    found: dict[str, list[int]] = {}
    for i in range(len(names)):
        steps, at = [], i
        while at >= 0:
            steps.append(names[at])
            at = parents[at]
        found.setdefault("\n".join(reversed(steps)), []).append(i)
    return found


@dataclass
class Apart:
    """Largest differences from what is expected, of lengths by the scene's size."""

    largest: dict[str, float] = field(default_factory=dict)
    seen: dict[str, int] = field(default_factory=dict)  # how much was compared

    def add(self, name: str, apart: Any) -> None:
        """Note a difference."""
        worst = float(np.abs(apart).max(initial=0.0))
        self.largest[name] = max(self.largest.get(name, 0.0), worst)
        self.seen[name] = self.seen.get(name, 0) + 1


def size_of(expected: dict[str, Any]) -> float:
    """Return the largest extent of a scene, over all its states."""
    rows = [np.zeros((1, 3))]
    for sample in expected["samples"]:
        rows.append(np.array(sample["world"]).reshape(-1, 3, 4)[:, :, 3])
        for points in sample.get("verts") or ():
            if points is not None:
                rows.append(np.array(points).reshape(-1, 3))
    every = np.concatenate(rows)
    return float(np.ptp(every, axis=0).max()) or 1.0


def compare(
    character: FbxCharacter,
    expected: dict[str, Any],
    *,
    points: bool = True,
) -> Apart:
    """Return how far a file is from its expected states.

    Those of files before 7000 between keys are apart: their tangents are resampled.
    """
    nodes = expected["nodes"]
    theirs = by_path([n["name"] for n in nodes], [n["parent"] for n in nodes])
    mine = character.paths()
    ours = {
        node: own
        for path, rows in theirs.items()
        for node, own in zip(rows, mine.get(path, ()), strict=False)
    }
    size, apart = size_of(expected), Apart()
    takes = [None, *(character.take(one["name"]) for one in expected["takes"])]
    for sample in expected["samples"]:
        take = takes[0 if sample["take"] is None else sample["take"] + 1]
        posed = character.pose(take, sample["t"] or 0.0)
        old = expected["version"] < 7000 and sample["at"] != "saved"
        keys = np.zeros(0) if take is None else take.key_times() / TICKS_PER_SECOND
        near = len(keys) and np.abs(keys - sample["t"]).min() < 1e-6
        kind = "resampled " if old and not near else ""
        _nodes(character, posed, sample, ours, size, kind, apart)
        _weights(character, posed, sample, expected, kind, apart)
        if points:
            _points(character, posed, sample, expected, ours, size, kind, apart)
    return apart


def _nodes(
    character: FbxCharacter,
    posed: Posed,
    sample: dict[str, Any],
    ours: dict[int, int],
    size: float,
    kind: str,
    apart: Apart,
) -> None:
    for node, rows in enumerate(sample["world"]):
        own = character.matrix(posed, ours[node]) if node in ours else None
        if own is None:
            continue
        matrix = np.array(rows).reshape(3, 4)
        apart.add(f"{kind}position", (own - matrix)[:, 3] / size)
        norm = float(np.linalg.norm(matrix[:, :3])) or 1.0
        apart.add(f"{kind}matrix", (own - matrix)[:, :3] / norm)


def _weights(
    character: FbxCharacter,
    posed: Posed,
    sample: dict[str, Any],
    expected: dict[str, Any],
    kind: str,
    apart: Apart,
) -> None:
    values = sample.get("shape_weights")
    if not values or posed.motion.weights is None:
        return
    weights = posed.motion.weights.dense()[0, :, 0]
    for shape, value in zip(expected["shapes"], values, strict=True):
        for row, (channel, full) in enumerate(character.made.shape_channels):
            if channel.name == shape["name"]:
                apart.add(f"{kind}weight", weights[row] * full / 100.0 - value)


def _points(
    character: FbxCharacter,
    posed: Posed,
    sample: dict[str, Any],
    expected: dict[str, Any],
    ours: dict[int, int],
    size: float,
    kind: str,
    apart: Apart,
) -> None:
    for mesh, rows in zip(expected["meshes"], sample.get("verts") or (), strict=False):
        if rows is None or mesh["node"] not in ours:
            continue
        own = character.points(posed, ours[mesh["node"]])
        if own is not None:
            given = np.array(rows).reshape(-1, 3)
            apart.add(f"{kind}point", (own[mesh["sampled"]] - given) / size)


def read_obj(path: Path) -> Array:
    """Return the points of an OBJ ``(V, 3)``."""
    rows = [
        line.split()[1:4]
        for line in path.read_text("utf-8", "replace").splitlines()
        if line.startswith("v ")
    ]
    return np.array(rows, np.float64)


def points_of_pair(character: FbxCharacter, pair: dict[str, Any]) -> Array | None:
    """Return the points that a pair compares, converted as it says; None for none."""
    scene = character.scene
    state, take = pair.get("state"), None
    if pair["time_s"] is None and state != "saved":
        return None
    if pair["time_s"] is not None:
        name = pair.get("take")
        take = character.take(name) if name else scene.takes[scene.default_take]
    if take is not None and pair.get("extrapolation") is False:
        take = _held(take)
    posed = character.pose(take, pair["time_s"] or 0.0)
    found = character.paths()
    by_name: dict[str, list[int]] = {}
    for path, nodes in found.items():
        by_name.setdefault(path.split("\n")[-1], []).extend(nodes)
    parts = []
    for block in pair.get("blocks") or [{"node": n} for n in by_name]:
        nodes = [n for n in by_name[block["node"]] if n in character.made.mesh_names]
        for node in nodes[:1]:
            own = character.points(posed, node)
            assert own is not None
            if pair.get("skin") == "with node":
                own = _with_node(character, take, pair["time_s"] or 0.0, node, own)
            parts.append(own)
    points = np.concatenate(parts)
    how = pair.get("conversion")
    if how:
        points = how["scale"] * points @ np.array(how["rows"], np.float64).T
    return points


def _held(take: AnimTake) -> AnimTake:
    """Return a take whose curves hold outside of their keys."""
    held = copy.deepcopy(take)
    for track in held.tracks.values():
        for one in track.layers:
            one.curves = [
                None
                if c is None
                else replace(c, pre=FbxExtrapolation(), post=FbxExtrapolation())
                for c in one.curves
            ]
    return held


def _with_node(
    character: FbxCharacter,
    take: AnimTake | None,
    seconds: float,
    node: int,
    own: Array,
) -> Array:
    """Return points taken on by the node of their mesh since it was bound."""
    scene = character.scene
    if scene.nodes[node].skin < 0:
        return own
    ticks = np.array([round(seconds * TICKS_PER_SECOND)], np.int64)
    world = NodeTransforms(scene, take, ticks).world_matrices(node)[0]
    step = world @ np.linalg.inv(scene.mesh_bind_worlds[scene.nodes[node].skin])
    return np.asarray(own @ step[:3, :3].T + step[:3, 3])
