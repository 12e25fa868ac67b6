"""Attachments of a rig as particles and springs."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import field
from itertools import pairwise

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.errors import (
    Fault,
    OptionError,
    RefusalCollector,
    counted,
    listed,
    refuse,
)
from animtool.core.record import dataclass
from animtool.maths.faces import edge_counts, edges, triangulate
from animtool.rig.kinematics import bind_matrices, bind_world
from animtool.rig.parts import AttachKind, Attachment
from animtool.rig.skeleton import Rig
from animtool.rig.surfaces import Surface, strands_of, surfaces_of
from animtool.skin.character import CharacterMesh, character_meshes, character_strands
from animtool.systems.attach.poses import PoseSamples
from animtool.systems.springs.body import Body, build_body
from animtool.systems.springs.records import Family
from animtool.systems.springs.shapes import face_diagonals, grid_pairs, hinge_pairs

# Frequency of springs that are treated as rigid [rad/s].
RIGID_FREQUENCY = 1e6
# Area density of cloth [kg/m²], and smallest particle mass relative to the largest [1].
CLOTH_AREA_DENSITY = 0.3
MIN_MASS_FRACTION = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class MassSpringNetwork:
    """The particles of an attachment at bind time, and the springs between them."""

    points: FloatArray  # bind positions ``(N, 3)`` [m]
    pinned: IntArray  # points that follow the animation ``(P,)``, ascending
    structural: IntArray  # ends of structural springs, along edges ``(L, 2)``
    # Ends of springs along face diagonals, against shear ``(L, 2)``.
    shear: IntArray = field(default_factory=lambda: np.zeros((0, 2), np.int64))
    # Ends of springs across edges, against bending ``(L, 2)``.
    bend: IntArray = field(default_factory=lambda: np.zeros((0, 2), np.int64))
    # Corners of surface triangles ``(T, 3)``.
    triangles: IntArray = field(default_factory=lambda: np.zeros((0, 3), np.int64))
    # Number of strands with equally many particles, stored one after the other from
    # their pinned roots; 0 for a surface.
    strands: int = 0

    @property
    def count(self) -> int:
        """Number of particles N."""
        return len(self.points)

    @property
    def is_pinned(self) -> BoolArray:
        """Mask of the pinned particles ``(N,)``."""
        return np.isin(np.arange(self.count), self.pinned)

    @property
    def rest_lengths(self) -> FloatArray:
        """Rest lengths of structural springs ``(L,)`` [m]."""
        first, second = self.points[self.structural].swapaxes(0, 1)
        return np.asarray(np.linalg.norm(second - first, axis=-1))

    @property
    def median_edge_length(self) -> float:
        """Median length of structural springs [m]; 0 without any."""
        lengths = self.rest_lengths
        return float(np.median(lengths[lengths > 0])) if lengths.any() else 0.0

    @property
    def triangle_normals(self) -> FloatArray:
        """Normals of triangles, twice as long as their area ``(T, 3)`` [m²]."""
        a, b, c = self.points[self.triangles].swapaxes(0, 1)
        return np.cross(b - a, c - a)

    @property
    def masses(self) -> FloatArray:
        """Particle masses ``(N,)`` [kg]: by area for cloth, else 1 each."""
        if not len(self.triangles):
            return np.ones(self.count)
        areas = np.linalg.norm(self.triangle_normals, axis=1) / 2
        corner_masses = np.repeat(areas * (CLOTH_AREA_DENSITY / 3), 3)
        masses = np.bincount(self.triangles.ravel(), corner_masses, self.count)
        # Particles with degenerate faces alone get a small mass.
        min_mass = MIN_MASS_FRACTION * float(masses.max(initial=0.0))
        return np.maximum(masses, min_mass if min_mass > 0 else 1.0)

    def body(self, diagonals: float, bends: float) -> Body:
        """Return the spring body, with shear and bend frequencies [Hz]."""
        families = (
            (self.structural, RIGID_FREQUENCY / (2 * math.pi)),
            (self.shear, diagonals),
            (self.bend, bends),
        )
        springs = [
            (ends[~self.is_pinned[ends].all(axis=1)], Family(frequency=frequency))
            for ends, frequency in families
            if frequency
        ]
        points, strands = self.points, self.strands
        return build_body(points, self.masses, springs, self.triangles, strands)


def max_pin_hops(network: MassSpringNetwork) -> int:
    """Return the largest number of springs from a pinned particle to any other.

    Without pinned particles, springs are counted from the first particle.

    >>> line = np.array([[0, 1], [1, 2]])
    >>> max_pin_hops(MassSpringNetwork(np.eye(3), np.array([0]), line))
    2
    """
    is_reached = np.zeros(network.count, np.bool_)
    is_reached[network.pinned if len(network.pinned) else [0]] = True
    first, second = network.structural.T
    hops = 0
    while True:
        is_next = is_reached[first] != is_reached[second]
        if not is_next.any():
            return hops
        is_reached[first[is_next]] = is_reached[second[is_next]] = True
        is_open = ~(is_reached[first] & is_reached[second])
        first, second = first[is_open], second[is_open]
        hops += 1


def surface_defects(network: MassSpringNetwork) -> list[str]:
    """Return defects of a surface as text: degenerate triangles, shared edges.

    >>> fan = np.array([[0, 1, 2], [0, 1, 3], [0, 1, 4]])
    >>> points, pinned = np.eye(5, 3), np.array([0])
    >>> network = MassSpringNetwork(points, pinned, fan[:, :2], triangles=fan)
    >>> surface_defects(network)
    ['1 edge of more than two triangles']
    """
    corners = network.triangles
    if not len(corners):
        return []
    degenerate_count = int((~network.triangle_normals.any(axis=1)).sum())
    face_counts = edge_counts(np.full(len(corners), 3), corners.ravel())[1]
    nonmanifold_count = int((face_counts > 2).sum())
    defects = {
        f"{counted(degenerate_count, 'triangle')} without area": degenerate_count,
        f"{counted(nonmanifold_count, 'edge')} of more than two triangles": (
            nonmanifold_count
        ),
    }
    return [defect for defect, count in defects.items() if count]


@dataclass(frozen=True, slots=True, eq=False)
class AttachedBody(ABC):
    """An attachment of a rig, modelled as particles.

    Attributes:
        name: Name in the rig.
        kind: One of `AttachKind`.
        network: Particles at the scale of the bind pose.
        carrier: Joint that carries the attachment.
    """

    name: str
    kind: str
    network: MassSpringNetwork
    carrier: int

    @abstractmethod
    def targets(self, samples: PoseSamples) -> FloatArray:
        """Return animated world positions of the particles ``(K, N, 3)`` [m]."""


@dataclass(frozen=True, slots=True, eq=False)
class ChainBody(AttachedBody):
    """A chain of joints: the first origin is pinned, and the bone ends swing."""

    joints: IntArray  # joint indices, from the root on ``(C,)``
    tip: FloatArray  # end of the last bone, in the frame of its joint ``(3,)`` [m]
    # Whether nothing follows the rotation of the last joint, which has no tip and no
    # joint, skin, collider or strands attached to it.
    has_free_tip: bool = False

    def targets(self, samples: PoseSamples) -> FloatArray:
        """Return animated joint origins, and the end of the last bone."""
        world, last = samples.world, self.joints[-1]
        end = (world.linear[:, last] * self.tip).sum(axis=-1)
        end += world.positions[:, last]
        return np.concatenate([world.positions[:, self.joints], end[:, None]], axis=1)


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceBody(AttachedBody):
    """Cloth or strands, as skinned points that are simulated."""

    # Skinned mesh; a motion stores its points under the same name.
    mesh: CharacterMesh

    def targets(self, samples: PoseSamples) -> FloatArray:
        """Return the animated points, deformed by shapes and skin."""
        return samples.deform(self.mesh)


def build_bodies(rig: Rig, names: tuple[str, ...]) -> list[AttachedBody]:
    """Return named attachments of a rig as particles; raise SIM030 for unknown ones."""
    by_name = {entry.name: entry for entry in rig.attach}
    kinds = [str(kind) for kind in AttachKind]
    faults = []
    hint = "it has none; write its cloth, hair or chains under attach of the rig"
    if by_name:
        hint = f"the rig has {', '.join(by_name)}"
    for name in names:
        if name not in by_name:
            message = f"unknown attachment {name!r} of {rig.name!r}"
            faults.append(Fault("SIM030", message, hint=hint))
        elif by_name[name].kind not in kinds:
            kind, allowed = by_name[name].kind, f"kinds: {', '.join(kinds)}"
            message = f"{name!r} is of kind {kind!r}, which cannot be simulated"
            faults.append(Fault("SIM030", message, hint=allowed))
    if faults:
        raise OptionError(faults)
    bodies: list[AttachedBody] = []
    refusals = RefusalCollector()
    for name in names:
        with refusals.collect():
            bodies.append(_BUILDERS[AttachKind(by_name[name].kind)](rig, by_name[name]))
    refusals.check()
    return bodies


def _build_chain(rig: Rig, entry: Attachment) -> AttachedBody:
    """Build the particles of a chain of joints."""
    joints = [rig.index(name) for name in entry.joints]
    for parent, child in pairwise(joints):
        if rig.joints[child].parent != parent:
            names = rig.joints[parent].name, rig.joints[child].name
            message = f"joints of {entry.name!r} are not a chain: {names[1]!r} is not "
            refuse("SIM033", f"{message}a child of {names[0]!r}")
    tip = _bone_end(rig, joints)
    bind = bind_world(rig)
    end = bind.positions[0, joints[-1]] + bind.linear[0, joints[-1]] @ tip
    points = np.concatenate([bind.positions[0, joints], end[None]])
    ends = grid_pairs(np.arange(len(points)), 1)
    network = MassSpringNetwork(points, np.array([0]), ends, strands=1)
    parent = rig.joints[joints[0]].parent
    carrier = parent if parent >= 0 else joints[0]
    is_free = _has_free_tip(rig, joints[-1])
    rows = np.array(joints)
    return ChainBody(entry.name, entry.kind, network, carrier, rows, tip, is_free)


def _has_free_tip(rig: Rig, joint: int) -> bool:
    """Return whether no joint, tip or surface follows a chain's last joint."""
    name = rig.joints[joint].name
    skin_joints = {n for mesh in rig.meshes if mesh.skin for n in mesh.skin.joints}
    attach_joints = {collider.joint for collider in rig.colliders}
    attach_joints |= {strands.joint for strands in strands_of(rig)}
    return not (
        rig.joints[joint].tips
        or any(child.parent == joint for child in rig.joints)
        or name in skin_joints | attach_joints
    )


def _bone_end(rig: Rig, joints: list[int]) -> FloatArray:
    """Return the end of a chain's last bone, in the frame of the last joint.

    This is the tip of the joint, else its first child, else a copy of the bone before.
    """
    last = rig.joints[joints[-1]]
    if last.tips:
        return np.array(last.tips[0])
    for joint in rig.joints:
        if joint.parent == joints[-1]:
            return np.array(joint.translation)
    return np.array(last.translation)


def _build_strands(rig: Rig, entry: Attachment) -> AttachedBody:
    """Build the particles of strands."""
    (strands,) = [strands for strands in strands_of(rig) if strands.name == entry.name]
    (mesh,) = character_strands([strands], rig.names, bind_matrices(rig))
    count, length = strands.points.shape[:2]
    particles = np.arange(count * length).reshape(count, length)
    network = MassSpringNetwork(
        strands.points.reshape(-1, 3),
        particles[:, 0],
        # Root to tip over all strands: the order in which springs are solved.
        grid_pairs(particles, 0, 1),
        bend=grid_pairs(particles, 0, 2),
        strands=count,
    )
    carrier = rig.index(strands.joint)
    return SurfaceBody(entry.name, entry.kind, network, carrier, mesh)


def _build_cloth(rig: Rig, entry: Attachment) -> AttachedBody:
    """Build the particles of cloth from its mesh."""
    (surface,) = [mesh for mesh in surfaces_of(rig) if mesh.name == entry.mesh]
    shapes = [shape.name for shape in rig.shapes]
    (mesh,) = character_meshes([surface], rig.names, bind_matrices(rig), shapes)
    faces = surface.counts, surface.indices
    ends = edges(*faces)
    if not len(ends):
        refuse("SIM033", f"the mesh of {entry.name!r} has no faces")
    isolated_points = np.setdiff1d(np.arange(len(surface.points)), ends)
    if len(isolated_points):
        points = listed(isolated_points.tolist())
        refuse("SIM033", f"points of {entry.name!r} are in no face: {points}")
    pins = np.zeros(0, np.int64)
    if entry.pins is not None:
        pins = np.unique(entry.pins.load()).astype(np.int64)
    bind = surface.geom_bind
    bind_points = surface.points @ bind[:3, :3].T + bind[:3, 3]
    # Larger faces have no diagonals.
    is_quad = surface.counts == 4
    is_quad_corner = np.repeat(is_quad, surface.counts)
    network = MassSpringNetwork(
        bind_points,
        pins,
        ends,
        face_diagonals(surface.counts[is_quad], surface.indices[is_quad_corner]),
        hinge_pairs(*faces),
        triangulate(*faces),
    )
    carrier = _main_joint(rig, surface, network)
    return SurfaceBody(entry.name, entry.kind, network, carrier, mesh)


def _main_joint(rig: Rig, surface: Surface, network: MassSpringNetwork) -> int:
    """Return the joint with the largest skin weight on pinned points."""
    skin = surface.skin
    if skin is None:
        return rig.roots[0]
    rows = network.pinned if len(network.pinned) else np.arange(network.count)
    weight_by_joint = np.bincount(
        skin.indices[rows].ravel(), skin.weights[rows].ravel(), len(skin.joints)
    )
    return rig.index(skin.joints[int(weight_by_joint.argmax())])


_BUILDERS = {
    AttachKind.SPRING_CHAIN: _build_chain,
    AttachKind.STRANDS: _build_strands,
    AttachKind.CLOTH: _build_cloth,
}
