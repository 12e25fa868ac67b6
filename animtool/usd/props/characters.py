"""Crowd characters: instances of rigs with separate or shared animations.

Samples that interpolation finds all the same are left out. The hips' own motion is in
the prim of the character, so that its animation has rotations alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import field
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt
from pxr import Gf, Sdf, Vt

from animtool.core.array_types import BoolArray, Float32Array, FloatArray, IntArray
from animtool.core.record import dataclass
from animtool.maths import so3
from animtool.motion.frames import Cast, CharactersFrame
from animtool.rig.kinematics import rest_world
from animtool.rig.surfaces import surfaces_of
from animtool.usd.caches.writer import CharactersReport
from animtool.usd.layers.names import RigPaths, distinct_names, joint_names
from animtool.usd.layers.sdf import (
    apply_schemas,
    attribute,
    author_order,
    prim,
    quatf,
    relationship,
    write_samples,
)
from animtool.usd.props.sparse import (
    NEAR,
    NEAR_STANDING,
    RotationChain,
    kept_samples,
    slerped,
    turning,
)
from animtool.usd.rigs.meshes import author_bones, author_meshes
from animtool.usd.rigs.skeleton import author_rig

_TYPES = Sdf.ValueTypeNames
PROTOTYPES, STANDING = "Prototypes", "Standing"
# Samples equal to both neighbors within this are dropped: position [m], heading [rad].
SAME_POSITION, SAME_HEADING = 1e-6, 1e-6
# Skin goes beyond joints by a part of how far these reach.
BEYOND = 1.2


@dataclass
class Characters:
    """Collects the frames of crowd characters, and writes them at the end.

    Attributes:
        path: Of the prim above them.
        unit: Of the layer [m].
        fps: Time codes a second.
    """

    path: str
    unit: float
    fps: float
    report: CharactersReport = field(default_factory=CharactersReport)
    codes: list[float] = field(default_factory=list)
    _first: CharactersFrame | None = None
    _rows: dict[str, list[npt.NDArray[Any]]] = field(default_factory=dict)
    _rotations: list[list[Float32Array]] = field(default_factory=list)

    def begin(self, layer: Any, frame: CharactersFrame) -> None:
        """Write the parent prim, and the rigs as invisible prototypes."""
        self._first = frame
        prim(layer, self.path, "Xform")
        for cast, paths in zip(frame.casts, self._rigs(frame), strict=True):
            _author_cast(layer, cast, paths, self.unit)
        above = prim(layer, f"{self.path}/{PROTOTYPES}", "Scope")
        above.specifier = Sdf.SpecifierClass
        above.ClearInfo("kind")

    def _rigs(self, frame: CharactersFrame) -> list[RigPaths]:
        """Return the paths of the rigs."""
        names = [cast.rig.name for cast in frame.casts]
        legal = distinct_names(names, names, names).names
        return [RigPaths.below(f"{self.path}/{PROTOTYPES}/{name}") for name in legal]

    def add(self, code: float, frame: CharactersFrame) -> None:
        """Add a frame."""
        self.codes.append(code)
        for name in ("points", "headings", "roots", "near_ground", "clocks", "visible"):
            self._rows.setdefault(name, []).append(getattr(frame, name))
        self._rotations.append(
            [rotations.astype(np.float32) for rotations in frame.joint_rotations]
        )

    def finish(self, layer: Any) -> None:
        """Write the characters."""
        frame = self._first
        assert frame is not None
        ends = np.cumsum(frame.counts).tolist()
        for c, (cast, paths) in enumerate(
            zip(frame.casts, self._rigs(frame), strict=True)
        ):
            rows = slice(ends[c] - int(frame.counts[c]), ends[c])
            parts = {
                name: np.stack([one[rows] for one in each])
                for name, each in self._rows.items()
            }
            rotations = np.stack([one[c] for one in self._rotations])
            track = _CharacterTrack(
                np.array(self.codes),
                _continuous(rotations),
                frame.scales[rows],
                cast,
                **parts,
            )
            group = _Group(self, layer, paths, frame.upright, track)
            group.bound()
            group.write([f"agent_{i + 1:04d}" for i in frame.ids[rows].tolist()])


def _author_cast(layer: Any, cast: Cast, paths: RigPaths, unit: float) -> None:
    """Write a rig, and the animation that standing characters share."""
    rig = cast.rig
    names = joint_names(rig.joints, 0)
    author_rig(layer, rig, names, paths, unit)
    if rig.meshes:
        tokens = dict(zip(rig.names, rig.paths(names.names), strict=True))
        author_meshes(layer, surfaces_of(rig), paths, tokens, unit)
    else:
        author_bones(layer, rig, paths, unit)
    root = layer.GetPrimAtPath(paths.root)
    apply_schemas(root, ["SkelBindingAPI"])
    relationship(root, "skel:skeleton", paths.skeleton)


@dataclass(frozen=True)
class _CharacterTrack:
    """n characters of one rig over F frames."""

    codes: FloatArray  # (F,)
    rotations: Float32Array  # (F, n, M, 4)
    scales: FloatArray  # (n,)
    cast: Cast
    points: FloatArray  # (F, n, 3) [m]
    headings: FloatArray  # (F, n) [rad]
    roots: FloatArray  # (F, n, 3) [m]
    near_ground: BoolArray  # (F, n, 2)
    clocks: FloatArray  # (F, n) [s]
    visible: BoolArray  # (F, n)

    @cached_property
    def size(self) -> float:
        """Return the reach of the rig's joints [m]."""
        return float(np.ptp(self.rest, axis=0).max())

    @cached_property
    def rest(self) -> FloatArray:
        """Return the rest positions of the joints ``(J, 3)`` [m]."""
        return np.asarray(rest_world(self.cast.rig).positions[0])

    @cached_property
    def arms(self) -> FloatArray:
        """Return each moving joint's reach to its farthest descendant ``(M,)`` [m]."""
        parents = self.cast.rig.parents.tolist()
        far = np.zeros(len(parents))
        for j in range(len(parents)):
            above = parents[j]
            while above >= 0:
                length = np.linalg.norm(self.rest[j] - self.rest[above])
                far[above] = max(far[above], float(length))
                above = parents[above]
        return np.asarray(far[self.cast.animated])

    @cached_property
    def shown(self) -> IntArray:
        """Return the joints that define a pose: moving joints and feet."""
        cast = self.cast
        return np.union1d(cast.animated, np.array(cast.feet))

    @cached_property
    def chain(self) -> RotationChain:
        """Return those joints as a chain, with static joints between them at rest."""
        rig, shown = self.cast.rig, self.shown.tolist()
        numbers = {joint: m for m, joint in enumerate(self.cast.animated.tolist())}
        parents, positions, rotations = [], [], []
        for joint in shown:
            position, rotation = rig.rest_translations[joint], so3.IDENTITY
            above = int(rig.parents[joint])
            while above >= 0 and above not in shown:
                rest = rig.rest_rotations[above]
                position = rig.rest_translations[above] + so3.rotate(rest, position)
                rotation = so3.multiply(rest, rotation)
                above = int(rig.parents[above])
            parents.append(shown.index(above) if above >= 0 else -1)
            positions.append(position)
            rotations.append(rotation)
        return RotationChain(
            np.array(parents),
            np.array([numbers.get(joint, -1) for joint in shown]),
            np.array(positions),
            np.array(rotations),
            rig.rest_rotations[self.shown],
            np.searchsorted(self.shown, self.cast.feet),
            self.size,
        )


@dataclass(frozen=True)
class _Group:
    """Characters of one rig in a layer."""

    owner: Characters
    layer: Any
    paths: RigPaths
    upright: FloatArray
    track: _CharacterTrack

    def write(self, names: Sequence[str]) -> None:
        """Write all characters, by name."""
        track, report = self.track, self.owner.report
        size = track.size * float(track.scales.max(initial=0.0))
        report.error = max(report.error, NEAR * size)
        report.slide = max(report.slide, NEAR_STANDING * size)
        shared = self._sharing()
        for i, name in enumerate(names):
            path = f"{self.owner.path}/{name}"
            if shared[i]:
                report.shared += 1
                self._author_root(path, i, None)
                self._use_shared(path, i)
                continue
            rotations = track.rotations[:, i].copy()
            moves = turning(rotations, track.arms, track.size)
            rotations[:, ~moves] = rotations[:1, ~moves]
            kept, moved = kept_samples(rotations, track.chain, track.near_ground[:, i])
            report.own += 1
            report.samples += int(kept.sum())
            report.frames += len(track.codes)
            self._author_root(path, i, moved)
            self._animate(path, rotations, moves, kept)

    def bound(self) -> None:
        """Author bounds of the rig that contain every pose.

        What is on a joint is no farther from the hips than when the rig lies stretched.
        """
        rest = self.track.rest
        far = float(np.linalg.norm(rest - rest[0], axis=1).max()) * BEYOND
        middle = rest[0] / self.owner.unit
        ends = np.stack(
            [middle - far / self.owner.unit, middle + far / self.owner.unit]
        )
        root = self.layer.GetPrimAtPath(self.paths.root)
        box = Vt.Vec3fArray.FromNumpy(ends.astype(np.float32))
        attribute(root, "extent", _TYPES.Float3Array, box)

    def _sharing(self) -> BoolArray:
        """Return which characters only stand and can share an animation ``(n,)``."""
        track = self.track
        static = np.isfinite(track.clocks).all(axis=0) & track.visible.all(axis=0)
        static &= np.ptp(track.points, axis=0).max(axis=-1) <= SAME_POSITION
        static &= np.ptp(track.headings, axis=0) <= SAME_HEADING
        # On uneven ground legs differ.
        cast = track.cast
        for i in np.flatnonzero(static).tolist():
            (at,) = _standing_values(cast, cast.rotations, track.clocks[:1, i])
            near = np.abs((at * track.rotations[0, i]).sum(axis=-1)) > 1 - 1e-6
            static[i] = bool(near.all())
        return np.asarray(static & (static.sum() > 1))

    def _author_root(self, path: str, i: int, put_right: FloatArray | None) -> None:
        """Write the root transform of a character, and its rig reference.

        ``put_right``: how far its hips are moved; None where its animation has them.
        """
        track, unit = self.track, self.owner.unit
        spec = prim(self.layer, path, "Xform")
        spec.SetInfo("kind", "component")
        motion = np.zeros((len(track.codes), 3))
        if put_right is not None:
            rest = track.cast.rig.rest_translations[0]
            motion = track.roots[:, i] - rest + put_right
        half = track.headings[:, i] / 2
        turned = np.zeros((len(half), 4))
        turned[:, 1], turned[:, 3] = np.sin(half), np.cos(half)
        off = so3.rotate(self.upright, so3.rotate(turned, motion * track.scales[i]))
        positions = ((track.points[:, i] + off) / unit).astype(np.float32)
        order = ["xformOp:translate"]
        translate = attribute(spec, "xformOp:translate", _TYPES.Float3)
        rows = _changing(positions, SAME_POSITION / unit)
        write_samples(
            self.layer,
            translate,
            track.codes,
            rows,
            [Gf.Vec3f(*one) for one in positions[rows].tolist()],
        )
        if (self.upright != so3.IDENTITY).any():
            attribute(spec, "xformOp:orient", _TYPES.Quatf, quatf(self.upright))
            order.append("xformOp:orient")
        translate = attribute(spec, "xformOp:rotateY", _TYPES.Float)
        degrees = np.degrees(track.headings[:, i]).astype(np.float32)
        rows = _changing(degrees[:, None], np.degrees(SAME_HEADING))
        write_samples(self.layer, translate, track.codes, rows, degrees[rows].tolist())
        order.append("xformOp:rotateY")
        if track.scales[i] != 1:
            size = Gf.Vec3f(*[float(track.scales[i])] * 3)
            attribute(spec, "xformOp:scale", _TYPES.Float3, size)
            order.append("xformOp:scale")
        author_order(spec, *order)
        visible = track.visible[:, i]
        if not visible.all():
            translate = attribute(spec, "visibility", _TYPES.Token)
            rows = np.flatnonzero(np.diff(visible, prepend=~visible[:1]))
            words = [
                "inherited" if one else "invisible" for one in visible[rows].tolist()
            ]
            write_samples(self.layer, translate, track.codes, rows, words)
        rig = prim(self.layer, f"{path}/Rig", "SkelRoot")
        rig.SetInfo("instanceable", True)
        rig.referenceList.explicitItems = [Sdf.Reference("", self.paths.root)]
        apply_schemas(rig, ["SkelBindingAPI"])
        relationship(rig, "skel:animationSource", f"{path}/Anim")

    def _animate(
        self, path: str, poses: Float32Array, moves: BoolArray, kept: BoolArray
    ) -> None:
        """Write a separate animation of poses ``(F, M, 4)`` for a character.

        Joints that do not move are in a pose that never changes, if they are not at
        rest.
        """
        rest = self.track.cast.rig.rest_rotations[self.track.cast.animated]
        moves = moves | ((poses[0] * rest).sum(axis=-1) ** 2 < 1 - 1e-9)
        spec = self._animation(f"{path}/Anim", np.flatnonzero(moves))
        rows = np.flatnonzero(kept)
        rotations = spec.attributes["rotations"]
        arrays = [
            Vt.QuatfArray.FromNumpy(np.ascontiguousarray(one))
            for one in poses[rows][:, moves]
        ]
        write_samples(self.layer, rotations, self.track.codes, rows, arrays)

    def _animation(self, path: str, which: IntArray) -> Any:
        """Return a new animation of joints that keep their rest translations."""
        cast, unit = self.track.cast, self.owner.unit
        joints = cast.animated[which]
        spec = prim(self.layer, path, "SkelAnimation")
        spec.SetInfo("customData", {"animtool": {"thinned": True}})
        tokens = cast.rig.paths(joint_names(cast.rig.joints, 0).names)
        moving = Vt.TokenArray([tokens[j] for j in joints.tolist()])
        attribute(spec, "joints", _TYPES.TokenArray, moving, uniform=True)
        rest = (cast.rig.rest_translations[joints] / unit).astype(np.float32)
        translations = Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(rest))
        attribute(spec, "translations", _TYPES.Float3Array, translations)
        attribute(spec, "rotations", _TYPES.QuatfArray)
        ones = Vt.Vec3hArray([Gf.Vec3h(1, 1, 1)] * len(joints))
        attribute(spec, "scales", _TYPES.Half3Array, ones)
        return spec

    def _use_shared(self, path: str, i: int) -> None:
        """Bind a character to the shared standing animation, with a time offset."""
        track, fps = self.track, self.owner.fps
        above = f"{self.paths.model}/{STANDING}"
        if self.layer.GetPrimAtPath(above) is None:
            self._write_shared(above)
        clock = float(track.clocks[0, i]) % max(track.cast.period, 1e-9)
        offset = float(track.codes[0]) - clock * fps
        spec = prim(self.layer, f"{path}/Anim", "SkelAnimation")
        spec.referenceList.explicitItems = [
            Sdf.Reference("", above, Sdf.LayerOffset(offset))
        ]

    def _write_shared(self, path: str) -> None:
        """Write the shared standing animation from 0 s, as long as any needs it."""
        cast, fps, codes = self.track.cast, self.owner.fps, self.track.codes
        spec = self._animation(path, np.arange(len(cast.animated)))
        spec.SetInfo("customData", {"animtool": {"thinned": True, "shared": True}})
        # Standing characters start at most one period before the first frame.
        last = (
            codes[-1] - codes[0] + cast.period * fps if len(cast.rotations) > 1 else 0.0
        )
        rows = np.arange(int(np.ceil(last)) + 1)
        clocks = rows / fps
        rotations = _continuous(
            _standing_values(cast, cast.rotations, clocks).astype(np.float32)
        )
        arrays = [
            Vt.QuatfArray.FromNumpy(np.ascontiguousarray(one)) for one in rotations
        ]
        codes = rows.astype(np.float64)
        write_samples(self.layer, spec.attributes["rotations"], codes, rows, arrays)
        moved = np.repeat(cast.rig.rest_translations[None, cast.animated], len(rows), 0)
        moved[:, cast.animated == 0] = _standing_values(cast, cast.roots, clocks)[
            :, None
        ]
        arrays = [
            Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(one))
            for one in (moved / self.owner.unit).astype(np.float32)
        ]
        write_samples(self.layer, spec.attributes["translations"], codes, rows, arrays)


def _standing_values(cast: Cast, table: FloatArray, clocks: FloatArray) -> FloatArray:
    """Return standing rotations or positions at clock times ``(K,)`` [s]."""
    count = len(table)
    at = clocks / (cast.period or 1.0) * count
    low = np.floor(at).astype(np.int64)
    fraction = at - low
    first, last = table[low % count], table[(low + 1) % count]
    if table.ndim == 2:
        return np.asarray(first + fraction[:, None] * (last - first))
    last = np.where((first * last).sum(axis=-1, keepdims=True) < 0, -last, last)
    return slerped(first, last, fraction[:, None])


def _continuous(rotations: Float32Array) -> Float32Array:
    """Return rotations ``(F, …, 4)`` with signs continuous over frames."""
    products = (rotations[1:] * rotations[:-1]).sum(axis=-1)
    signs = np.cumprod(np.where(products < 0, -1, 1), axis=0).astype(np.float32)
    continuous = rotations.copy()
    continuous[1:] *= signs[..., None]
    return continuous


def _changing(values: Float32Array, same: float) -> IntArray:
    """Return the frames of values ``(F, K)`` without those between equal neighbors."""
    steps = (np.abs(np.diff(values, axis=0)) > same).any(axis=1)
    if not steps.any():
        return np.zeros(1, np.int64)
    kept = np.append(True, steps) | np.append(steps, True)
    return np.flatnonzero(kept)
