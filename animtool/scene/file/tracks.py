"""Selection of a rig's tracks: joints, shapes and controls."""

from __future__ import annotations

from fnmatch import fnmatchcase

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.record import dataclass
from animtool.motion.motion import Channel, Motion
from animtool.rig.joints import DRIVEN_PARTS, split_part
from animtool.rig.skeleton import Rig
from animtool.scene.sources.onto_rig import NameMap

TRACK_KINDS = ("joints", "shapes", "controls")


@dataclass(frozen=True, slots=True)
class TrackNames:
    """Names or patterns of the tracks that one of several sources sets."""

    joints: tuple[str, ...] = ()
    shapes: tuple[str, ...] = ()
    controls: tuple[str, ...] = ()  # controls; the tracks they drive are included


@dataclass(frozen=True, slots=True)
class Tracks:
    """Indices of the tracks that a source sets on a rig, ascending."""

    joints: IntArray
    shapes: IntArray
    controls: IntArray

    def __bool__(self) -> bool:
        """Whether any track is selected."""
        return any(len(self.indices(kind)) for kind in TRACK_KINDS)

    def indices(self, kind: str) -> IntArray:
        """Return the track indices of a kind, which is one of `TRACK_KINDS`."""
        indices: IntArray = getattr(self, kind)
        return indices

    def names(self, rig: Rig) -> list[str]:
        """Return the names of the selected joints, shapes and controls."""
        return [
            getattr(rig, kind)[i].name
            for kind in TRACK_KINDS
            for i in self.indices(kind)
        ]

    def intersection(self, other_tracks: Tracks) -> Tracks:
        """Return the tracks that another selection contains too."""
        pairs = ((self.indices(k), other_tracks.indices(k)) for k in TRACK_KINDS)
        return Tracks(*(np.intersect1d(*pair) for pair in pairs))


def select_tracks(
    requested_names: TrackNames, name_map: NameMap
) -> tuple[Tracks, list[tuple[str, str, list[str]]]]:
    """Return the tracks of two rigs that match patterns, and the unmatched patterns.

    An unmatched pattern comes with its kind of track and the valid names. Tracks that a
    selected control drives are selected too, since a motion stores their values.
    """
    rig, unmatched_patterns = name_map.rig, []
    indices_by_kind: dict[str, set[int]] = {kind: set() for kind in TRACK_KINDS}
    for kind in TRACK_KINDS:
        mapped_indices = np.flatnonzero(getattr(name_map, kind) >= 0).tolist()
        index_by_name = {getattr(rig, kind)[i].name: i for i in mapped_indices}
        for pattern in getattr(requested_names, kind):
            indices = {i for n, i in index_by_name.items() if fnmatchcase(n, pattern)}
            if not indices:
                unmatched_patterns.append((kind, pattern, list(index_by_name)))
            indices_by_kind[kind] |= indices
    _add_driven_tracks(rig, indices_by_kind)
    tracks = (np.array(sorted(indices_by_kind[kind]), np.int64) for kind in TRACK_KINDS)
    return _common_tracks(Tracks(*tracks), name_map), unmatched_patterns


def _add_driven_tracks(rig: Rig, indices_by_kind: dict[str, set[int]]) -> None:
    """Add the tracks that selected controls drive, recursively."""
    index_by_name: dict[str, dict[str, int]] = {}
    for kind in TRACK_KINDS:
        elements = enumerate(getattr(rig, kind))
        index_by_name[kind.removesuffix("s")] = {
            element.name: i for i, element in elements
        }
    pending_controls = sorted(indices_by_kind["controls"])
    while pending_controls:
        for drive in rig.controls[pending_controls.pop()].drives:
            kind, _, name = drive.target.partition("/")
            if kind == "joint":
                name, _ = split_part(name, DRIVEN_PARTS)
            index = index_by_name[kind][name]
            if kind == "control" and index not in indices_by_kind["controls"]:
                pending_controls.append(index)
            indices_by_kind[f"{kind}s"].add(index)


def moving_tracks(motion: Motion, name_map: NameMap, motion_rig: Rig) -> Tracks:
    """Return the tracks of a motion that are animated or differ from the rest pose."""
    rest_on_rig = name_map.apply(rest_motion(motion_rig))

    def moving_indices(kind: str) -> IntArray:
        channel: Channel | None = getattr(motion, kind)
        if channel is None:
            return np.zeros(0, np.int64)
        rest_channel: Channel | None = getattr(rest_on_rig, kind)
        rest_values = 1.0 if rest_channel is None else rest_channel.rest
        is_moving = (channel.rest != rest_values).any(axis=1)
        is_moving[channel.animated] = True
        return np.flatnonzero(is_moving)

    joints = [moving_indices(kind) for kind in ("translations", "rotations", "scales")]
    shapes, controls = moving_indices("weights"), moving_indices("controls")
    tracks = Tracks(np.unique(np.concatenate(joints)), shapes, controls)
    return _common_tracks(tracks, name_map)


def rest_motion(rig: Rig) -> Motion:
    """Return one frame of a rig in the rest pose, with controls at their defaults."""
    weights = np.zeros((1, len(rig.shapes), 1))
    return Motion(
        Channel.from_dense(rig.rest_translations[None]),
        Channel.from_dense(rig.rest_rotations[None]),
        weights=Channel.from_dense(weights) if rig.shapes else None,
        controls=Channel.from_dense(_control_defaults(rig)[None])
        if rig.controls
        else None,
    )


def _control_defaults(rig: Rig) -> FloatArray:
    return np.array([[control.default] for control in rig.controls])


def _common_tracks(tracks: Tracks, name_map: NameMap) -> Tracks:
    """Return the selected tracks that exist in both rigs of a name map."""
    pairs = ((tracks.indices(kind), getattr(name_map, kind)) for kind in TRACK_KINDS)
    return Tracks(
        *(indices[mapped_indices[indices] >= 0] for indices, mapped_indices in pairs)
    )


def with_tracks(rig: Rig, base: Motion, replacement: Motion, tracks: Tracks) -> Motion:
    """Return a motion in which some tracks are replaced by those of another motion."""

    def replace_optional(
        name: str, indices: IntArray, neutral: float | FloatArray
    ) -> Channel | None:
        base_channel: Channel | None = getattr(base, name)
        other_channel: Channel | None = getattr(replacement, name)
        if not len(indices) or (base_channel is None and other_channel is None):
            return base_channel
        base_channel = base_channel or _constant_channel(other_channel, neutral)
        other_channel = other_channel or _constant_channel(base_channel, neutral)
        return _replace_entries(base_channel, other_channel, indices)

    return Motion(
        _replace_entries(base.translations, replacement.translations, tracks.joints),
        _replace_entries(base.rotations, replacement.rotations, tracks.joints),
        replace_optional("scales", tracks.joints, 1.0),
        replace_optional("weights", tracks.shapes, 0.0),
        replace_optional("controls", tracks.controls, _control_defaults(rig)),
    )


def _constant_channel(template: Channel | None, value: float | FloatArray) -> Channel:
    """Return a constant channel of another channel's size."""
    assert template is not None
    rest_values = np.broadcast_to(value, template.rest.shape).astype(np.float64)
    return Channel.static(rest_values, len(template.values))


def _replace_entries(
    channel: Channel, replacement: Channel, indices: IntArray
) -> Channel:
    """Return a channel with the entries at indices replaced by another channel's."""
    rest_values = channel.rest.copy()
    rest_values[indices] = replacement.rest[indices]
    is_kept = ~np.isin(channel.animated, indices)
    is_replacement = np.isin(replacement.animated, indices)
    masked_channels = ((channel, is_kept), (replacement, is_replacement))
    animated_entries = np.concatenate([c.animated[mask] for c, mask in masked_channels])
    values = np.concatenate([c.values[:, mask] for c, mask in masked_channels], axis=1)
    order = np.argsort(animated_entries, kind="stable")
    return Channel(rest_values, animated_entries[order], values[:, order])
