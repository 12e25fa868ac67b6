"""A motion brought onto another rig, by the names of joints, shapes and controls."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from animtool._types import FloatArray, IntArray
from animtool.rig.skeleton import Rig
from animtool.take import Channel, Motion

__all__ = ["NameMap", "map_names"]


@dataclass(frozen=True, slots=True)
class NameMap:
    """Where what a rig has is in another one.

    Attributes:
        rig: J joints.
        joints: Of the other rig, by joint of this one; -1 where it has none ``(J,)``.
        shapes: Likewise.
        controls: Likewise.
        spare: Joints of the other rig that this one lacks.
    """

    rig: Rig
    joints: IntArray
    shapes: IntArray
    controls: IntArray
    spare: tuple[int, ...]

    def apply(self, motion: Motion) -> Motion:
        """Return a motion of the other rig as one of this; what it lacks is at rest."""
        rig, ones = self.rig, np.ones((len(self.rig.joints), 3))
        nothing = np.zeros((len(rig.shapes), 1))
        defaults = np.array([[control.default] for control in rig.controls])
        return Motion(
            _moved(motion.translations, self.joints, rig.rest_translations),
            _moved(motion.rotations, self.joints, rig.rest_rotations),
            _moved_if(motion.scales, self.joints, ones),
            _moved_if(motion.weights, self.shapes, nothing),
            _moved_if(motion.controls, self.controls, defaults),
        )


def map_names(rig: Rig, other: Rig) -> NameMap:
    """Return where what a rig has is in another, by name.

    A joint whose source called it otherwise is found under both names.
    """
    known: dict[str, int] = {}
    for j, joint in enumerate(other.joints):
        known.setdefault(joint.source_name or joint.name, j)
        known.setdefault(joint.name, j)
    joints = [
        known.get(joint.name, known.get(joint.source_name, -1)) for joint in rig.joints
    ]
    return NameMap(
        rig,
        np.array(joints, np.int64),
        _indices([s.name for s in rig.shapes], [s.name for s in other.shapes]),
        _indices([c.name for c in rig.controls], [c.name for c in other.controls]),
        tuple(sorted(set(range(len(other.joints))) - set(joints))),
    )


def _indices(names: list[str], others: list[str]) -> IntArray:
    known = {name: i for i, name in enumerate(others)}
    return np.array([known.get(name, -1) for name in names], np.int64)


def _moved_if(
    channel: Channel | None, own: IntArray, rest: FloatArray
) -> Channel | None:
    return None if channel is None or not len(own) else _moved(channel, own, rest)


def _moved(channel: Channel, own: IntArray, rest: FloatArray) -> Channel:
    """Return the values at some indices, -1 being one that stays at rest."""
    there = own >= 0
    whole = np.array(rest, np.float64)
    whole[there] = channel.rest[own[there]]
    places = np.full(len(channel.rest), -1)
    places[channel.animated] = np.arange(len(channel.animated))
    at = np.full(len(own), -1)
    at[there] = places[own[there]]
    animated = np.flatnonzero(at >= 0)
    return Channel(whole, animated, channel.values[:, at[animated]])
