"""What carries particles that are held: joints, vertices and prims in motion."""

from __future__ import annotations

from dataclasses import field
from pathlib import Path

import numpy as np

from animtool.core.errors import Fault, OptionError
from animtool.core.names import nearest
from animtool.core.record import dataclass
from animtool.core.units import UpAxis
from animtool.maths import so3
from animtool.motion.transforms import PropRequest
from animtool.rig.skeleton import Rig
from animtool.rig.surfaces import surfaces_of
from animtool.scene.file.entries import Place
from animtool.scene.systems.character_motion import (
    CharacterMotions,
    CharacterSkin,
    no_mesh,
)
from animtool.sim.colliders import Poses, joint_poses
from animtool.systems.framework.fields import PlacedModel

# Between two of these a prim goes straight, whatever turns it [1/s].
PRIM_RATE = 120
# Times of a prim that are looked at, at most.
MAX_TIMES = 100_000


@dataclass(frozen=True, slots=True)
class OnJoint:
    """A joint of a character."""

    file: Path  # A clip or a scene
    joint: str  # its name
    # Of the entry that names it.
    place: Place | None = field(default=None, compare=False, repr=False)

    def fault(self, rig: Rig) -> Fault | None:
        """Return what is wrong with it, at its key; None where it is there."""
        if self.joint in rig.names:
            return None
        message = f"unknown joint {self.joint!r} of {rig.name!r}"
        hint = nearest(self.joint, list(rig.names))
        return Fault("SIM053", message, hint=hint, where="joint")

    def poses(self, characters: CharacterMotions) -> Poses:
        """Return where it is over time."""
        found = characters.of(self.file)
        _check(self.fault(found.rig), self.place)
        return joint_poses(found.world, found.rig.index(self.joint), found.times)


@dataclass(frozen=True, slots=True)
class OnVertex:
    """A vertex of a character's mesh."""

    file: Path  # A clip or a scene
    mesh: str  # name of the mesh
    vertex: int  # its number
    # Of the entry that names it.
    place: Place | None = field(default=None, compare=False, repr=False)

    def fault(self, rig: Rig) -> Fault | None:
        """Return what is wrong with it, at its key; None where it is there."""
        fault = no_mesh(rig, self.mesh)
        if fault is not None:
            return fault
        (mesh,) = [one for one in surfaces_of(rig) if one.name == self.mesh]
        last = len(mesh.points) - 1
        if self.vertex <= last:
            return None
        message = f"{self.mesh!r} has no vertex {self.vertex}: vertices are 0 to {last}"
        return Fault("SIM053", message, where="vertex")

    def poses(self, characters: CharacterMotions) -> Poses:
        """Return where it is over time; it never turns."""
        found = characters.of(self.file)
        _check(self.fault(found.rig), self.place)
        # The next block stands where the last one did.
        parts = [
            block.points[:, self.vertex].copy()
            for block in CharacterSkin(found, self.mesh).blocks()
        ]
        places = np.concatenate(parts)
        return Poses(found.times, places, np.tile(so3.IDENTITY, (len(places), 1)))


def _check(fault: Fault | None, place: Place | None) -> None:
    if fault is not None:
        raise OptionError(fault if place is None else place.put(fault))


@dataclass(frozen=True, slots=True)
class OnPrim:
    """A prim of a USD file."""

    file: Path  # the file
    prim: str  # path of the prim
    frame: float | None = None  # time code that comes at 0 s; None is the first

    def poses(self, characters: CharacterMotions) -> Poses:  # noqa: ARG002
        """Return where it is over time."""
        return self.over_time()

    def over_time(self) -> Poses:
        """Return where it is over time, the frame of 0 s among its times."""
        from animtool.usd.props.reader import open_prop

        prop = open_prop(PropRequest(self.file, self.prim, self.prim), UpAxis.Y)
        codes, start = np.zeros(1), 0.0
        if prop.span is not None:
            first, last = map(float, prop.span)
            start = first if self.frame is None else self.frame
            seconds = (last - first) / float(prop.fps)
            count = min(int(np.ceil(seconds * PRIM_RATE)) + 1, MAX_TIMES)
            codes = np.linspace(first, last, max(count, 2))
            codes = np.unique(np.concatenate([codes, prop.keys]))
            codes = codes[(codes >= first) & (codes <= last)]
        found = prop.track.sample(codes)
        times = (codes - start) / float(prop.fps)
        return Poses(times, found.translations, so3.align_signs(found.rotations))


def moved_poses(model: PlacedModel, own: Poses) -> Poses:
    """Return where an entry stands that moves and turns by itself."""
    if not model.moves and not model.turns:
        return own
    ways = np.array(model.moves or [[0.0] * 4])
    turns = np.array(model.turns or [[0.0, 1.0, 0.0, 0.0, 0.0]])
    still = np.zeros((len(turns), 3))
    gone = Poses(ways[:, 0], ways[:, 1:], np.tile(so3.IDENTITY, (len(ways), 1)))
    turned = Poses(turns[:, 0], still, turns[:, [2, 3, 4, 1]])
    # Each goes evenly between its own times, and so it does between those of both.
    times = ways[:, 0] if not model.turns else turns[:, 0]
    if model.moves and model.turns:
        times = np.union1d(ways[:, 0], turns[:, 0])
    place = own.rows[0]
    return Poses(
        times,
        gone.over(times)[:, :3] + place[:3],
        so3.multiply(turned.over(times)[:, 3:], place[3:]),
    )
