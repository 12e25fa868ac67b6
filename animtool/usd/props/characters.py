"""Characters of a crowd: instances of rigs, each with an animation or a part in one.

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
    put_samples,
    quatf,
    relationship,
)
from animtool.usd.props.sparse import (
    NEAR,
    NEAR_STANDING,
    Chain,
    kept_samples,
    slerped,
    turning,
)
from animtool.usd.rigs.meshes import author_bones, author_meshes
from animtool.usd.rigs.skeleton import author_rig

_TYPES = Sdf.ValueTypeNames
PROTOTYPES, STANDING = "Prototypes", "Standing"
# A place that neighbours have too is left out [m], and so is a heading [rad].
SAME_POSITION, SAME_HEADING = 1e-6, 1e-6
# Skin goes beyond joints by a part of how far these reach.
BEYOND = 1.2


@dataclass
class Characters:
    """Takes the frames of characters, and writes them at the end.

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
    _turns: list[list[Float32Array]] = field(default_factory=list)

    def begin(self, layer: Any, frame: CharactersFrame) -> None:
        """Write the prim above them, and the rigs, which nothing shows."""
        self._first = frame
        prim(layer, self.path, "Xform")
        for cast, paths in zip(frame.casts, self._rigs(frame), strict=True):
            _author_cast(layer, cast, paths, self.unit)
        above = prim(layer, f"{self.path}/{PROTOTYPES}", "Scope")
        above.specifier = Sdf.SpecifierClass
        above.ClearInfo("kind")

    def _rigs(self, frame: CharactersFrame) -> list[RigPaths]:
        """Return where the rigs are."""
        names = [cast.rig.name for cast in frame.casts]
        legal = distinct_names(names, names, names).names
        return [RigPaths.below(f"{self.path}/{PROTOTYPES}/{name}") for name in legal]

    def add(self, code: float, frame: CharactersFrame) -> None:
        """Take a frame."""
        self.codes.append(code)
        for name in ("points", "headings", "roots", "near", "clocks", "visible"):
            self._rows.setdefault(name, []).append(getattr(frame, name))
        self._turns.append([turns.astype(np.float32) for turns in frame.turns])

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
            turns = np.stack([one[c] for one in self._turns])
            track = _Track(
                np.array(self.codes),
                _continuous(turns),
                frame.scales[rows],
                cast,
                **parts,
            )
            group = _Group(self, layer, paths, frame.upright, track)
            group.bound()
            group.write([f"agent_{i + 1:04d}" for i in frame.ids[rows].tolist()])


def _author_cast(layer: Any, cast: Cast, paths: RigPaths, unit: float) -> None:
    """Write a rig, and what characters do who but stand."""
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
class _Track:
    """n characters of one rig over F frames."""

    codes: FloatArray  # (F,)
    turns: Float32Array  # (F, n, M, 4)
    scales: FloatArray  # (n,)
    cast: Cast
    points: FloatArray  # (F, n, 3) [m]
    headings: FloatArray  # (F, n) [rad]
    roots: FloatArray  # (F, n, 3) [m]
    near: BoolArray  # (F, n, 2)
    clocks: FloatArray  # (F, n) [s]
    visible: BoolArray  # (F, n)

    @cached_property
    def size(self) -> float:
        """Return how far the joints of the rig reach [m]."""
        return float(np.ptp(self.rest, axis=0).max())

    @cached_property
    def rest(self) -> FloatArray:
        """Return where joints are at rest ``(J, 3)`` [m]."""
        return np.asarray(rest_world(self.cast.rig).positions[0])

    @cached_property
    def arms(self) -> FloatArray:
        """Return how far joints below each that moves are from it ``(M,)`` [m]."""
        parents = self.cast.rig.parents.tolist()
        far = np.zeros(len(parents))
        for j in range(len(parents)):
            above = parents[j]
            while above >= 0:
                way = np.linalg.norm(self.rest[j] - self.rest[above])
                far[above] = max(far[above], float(way))
                above = parents[above]
        return np.asarray(far[self.cast.moves])

    @cached_property
    def shown(self) -> IntArray:
        """Return joints that show what a pose is: those that move, and feet."""
        cast = self.cast
        return np.union1d(cast.moves, np.array(cast.feet))

    @cached_property
    def chain(self) -> Chain:
        """Return the joints that show what a pose is, those between at rest."""
        rig, shown = self.cast.rig, self.shown.tolist()
        numbers = {joint: m for m, joint in enumerate(self.cast.moves.tolist())}
        parents, places, turns = [], [], []
        for joint in shown:
            place, turn = rig.rest_translations[joint], so3.IDENTITY
            above = int(rig.parents[joint])
            while above >= 0 and above not in shown:
                own = rig.rest_rotations[above]
                place = rig.rest_translations[above] + so3.rotate(own, place)
                turn = so3.multiply(own, turn)
                above = int(rig.parents[above])
            parents.append(shown.index(above) if above >= 0 else -1)
            places.append(place)
            turns.append(turn)
        return Chain(
            np.array(parents),
            np.array([numbers.get(joint, -1) for joint in shown]),
            np.array(places),
            np.array(turns),
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
    track: _Track

    def write(self, names: Sequence[str]) -> None:
        """Write all of them, by name."""
        track, report = self.track, self.owner.report
        size = track.size * float(track.scales.max(initial=0.0))
        report.error = max(report.error, NEAR * size)
        report.slide = max(report.slide, NEAR_STANDING * size)
        shared = self._sharing()
        for i, name in enumerate(names):
            path = f"{self.owner.path}/{name}"
            if shared[i]:
                report.shared += 1
                self._place(path, i, None)
                self._share(path, i)
                continue
            turns = track.turns[:, i].copy()
            moves = turning(turns, track.arms, track.size)
            turns[:, ~moves] = turns[:1, ~moves]
            kept, moved = kept_samples(turns, track.chain, track.near[:, i])
            report.own += 1
            report.samples += int(kept.sum())
            report.frames += len(track.codes)
            self._place(path, i, moved)
            self._animate(path, turns, moves, kept)

    def bound(self) -> None:
        """Write bounds of the rig that hold whatever a character does.

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
        """Return who does but stand all the time, as others do ``(n,)``."""
        track = self.track
        still = np.isfinite(track.clocks).all(axis=0) & track.visible.all(axis=0)
        still &= np.ptp(track.points, axis=0).max(axis=-1) <= SAME_POSITION
        still &= np.ptp(track.headings, axis=0) <= SAME_HEADING
        # On uneven ground legs differ.
        cast = track.cast
        for i in np.flatnonzero(still).tolist():
            (at,) = _standing(cast, cast.turns, track.clocks[:1, i])
            near = np.abs((at * track.turns[0, i]).sum(axis=-1)) > 1 - 1e-6
            still[i] = bool(near.all())
        return np.asarray(still & (still.sum() > 1))

    def _place(self, path: str, i: int, put_right: FloatArray | None) -> None:
        """Write where a character is, and its rig.

        ``put_right``: how far its hips are moved; None where its animation has them.
        """
        track, unit = self.track, self.owner.unit
        spec = prim(self.layer, path, "Xform")
        spec.SetInfo("kind", "component")
        own = np.zeros((len(track.codes), 3))
        if put_right is not None:
            rest = track.cast.rig.rest_translations[0]
            own = track.roots[:, i] - rest + put_right
        half = track.headings[:, i] / 2
        turned = np.zeros((len(half), 4))
        turned[:, 1], turned[:, 3] = np.sin(half), np.cos(half)
        off = so3.rotate(self.upright, so3.rotate(turned, own * track.scales[i]))
        places = ((track.points[:, i] + off) / unit).astype(np.float32)
        order = ["xformOp:translate"]
        translate = attribute(spec, "xformOp:translate", _TYPES.Float3)
        rows = _changing(places, SAME_POSITION / unit)
        put_samples(
            self.layer,
            translate,
            track.codes,
            rows,
            [Gf.Vec3f(*one) for one in places[rows].tolist()],
        )
        if (self.upright != so3.IDENTITY).any():
            attribute(spec, "xformOp:orient", _TYPES.Quatf, quatf(self.upright))
            order.append("xformOp:orient")
        translate = attribute(spec, "xformOp:rotateY", _TYPES.Float)
        degrees = np.degrees(track.headings[:, i]).astype(np.float32)
        rows = _changing(degrees[:, None], np.degrees(SAME_HEADING))
        put_samples(self.layer, translate, track.codes, rows, degrees[rows].tolist())
        order.append("xformOp:rotateY")
        if track.scales[i] != 1:
            size = Gf.Vec3f(*[float(track.scales[i])] * 3)
            attribute(spec, "xformOp:scale", _TYPES.Float3, size)
            order.append("xformOp:scale")
        author_order(spec, *order)
        seen = track.visible[:, i]
        if not seen.all():
            translate = attribute(spec, "visibility", _TYPES.Token)
            rows = np.flatnonzero(np.diff(seen, prepend=~seen[:1]))
            words = ["inherited" if one else "invisible" for one in seen[rows].tolist()]
            put_samples(self.layer, translate, track.codes, rows, words)
        rig = prim(self.layer, f"{path}/Rig", "SkelRoot")
        rig.SetInfo("instanceable", True)
        rig.referenceList.explicitItems = [Sdf.Reference("", self.paths.root)]
        apply_schemas(rig, ["SkelBindingAPI"])
        relationship(rig, "skel:animationSource", f"{path}/Anim")

    def _animate(
        self, path: str, turns: Float32Array, moves: BoolArray, kept: BoolArray
    ) -> None:
        """Write an animation of a character's own, of poses ``(F, M, 4)``.

        Joints that do not move are in a pose that never changes, if they are not at
        rest.
        """
        rest = self.track.cast.rig.rest_rotations[self.track.cast.moves]
        moves = moves | ((turns[0] * rest).sum(axis=-1) ** 2 < 1 - 1e-9)
        spec = self._animation(f"{path}/Anim", np.flatnonzero(moves))
        rows = np.flatnonzero(kept)
        rotations = spec.attributes["rotations"]
        arrays = [
            Vt.QuatfArray.FromNumpy(np.ascontiguousarray(one))
            for one in turns[rows][:, moves]
        ]
        put_samples(self.layer, rotations, self.track.codes, rows, arrays)

    def _animation(self, path: str, which: IntArray) -> Any:
        """Return a new animation of some joints that stay where they are at rest."""
        cast, unit = self.track.cast, self.owner.unit
        joints = cast.moves[which]
        spec = prim(self.layer, path, "SkelAnimation")
        spec.SetInfo("customData", {"animtool": {"thinned": True}})
        tokens = cast.rig.paths(joint_names(cast.rig.joints, 0).names)
        moving = Vt.TokenArray([tokens[j] for j in joints.tolist()])
        attribute(spec, "joints", _TYPES.TokenArray, moving, uniform=True)
        rest = (cast.rig.rest_translations[joints] / unit).astype(np.float32)
        places = Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(rest))
        attribute(spec, "translations", _TYPES.Float3Array, places)
        attribute(spec, "rotations", _TYPES.QuatfArray)
        ones = Vt.Vec3hArray([Gf.Vec3h(1, 1, 1)] * len(joints))
        attribute(spec, "scales", _TYPES.Half3Array, ones)
        return spec

    def _share(self, path: str, i: int) -> None:
        """Write that a character has a part in the animation of those who stand."""
        track, fps = self.track, self.owner.fps
        above = f"{self.paths.model}/{STANDING}"
        if self.layer.GetPrimAtPath(above) is None:
            self._stand(above)
        clock = float(track.clocks[0, i]) % max(track.cast.period, 1e-9)
        offset = float(track.codes[0]) - clock * fps
        spec = prim(self.layer, f"{path}/Anim", "SkelAnimation")
        spec.referenceList.explicitItems = [
            Sdf.Reference("", above, Sdf.LayerOffset(offset))
        ]

    def _stand(self, path: str) -> None:
        """Write what those do who stand, from 0 s on, for as long as any could."""
        cast, fps, codes = self.track.cast, self.owner.fps, self.track.codes
        spec = self._animation(path, np.arange(len(cast.moves)))
        spec.SetInfo("customData", {"animtool": {"thinned": True, "shared": True}})
        # Whoever stands is at most a period ahead of the first frame.
        last = codes[-1] - codes[0] + cast.period * fps if len(cast.turns) > 1 else 0.0
        rows = np.arange(int(np.ceil(last)) + 1)
        clocks = rows / fps
        turns = _continuous(_standing(cast, cast.turns, clocks).astype(np.float32))
        arrays = [Vt.QuatfArray.FromNumpy(np.ascontiguousarray(one)) for one in turns]
        codes = rows.astype(np.float64)
        put_samples(self.layer, spec.attributes["rotations"], codes, rows, arrays)
        moved = np.repeat(cast.rig.rest_translations[None, cast.moves], len(rows), 0)
        moved[:, cast.moves == 0] = _standing(cast, cast.roots, clocks)[:, None]
        arrays = [
            Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(one))
            for one in (moved / self.owner.unit).astype(np.float32)
        ]
        put_samples(self.layer, spec.attributes["translations"], codes, rows, arrays)


def _standing(cast: Cast, table: FloatArray, clocks: FloatArray) -> FloatArray:
    """Return turns or places of who has stood for times ``(K,)`` [s]."""
    count = len(table)
    at = clocks / (cast.period or 1.0) * count
    low = np.floor(at).astype(np.int64)
    share = at - low
    first, last = table[low % count], table[(low + 1) % count]
    if table.ndim == 2:
        return np.asarray(first + share[:, None] * (last - first))
    last = np.where((first * last).sum(axis=-1, keepdims=True) < 0, -last, last)
    return slerped(first, last, share[:, None])


def _continuous(turns: Float32Array) -> Float32Array:
    """Return turns ``(F, …, 4)`` whose signs go on from frame to frame."""
    products = (turns[1:] * turns[:-1]).sum(axis=-1)
    signs = np.cumprod(np.where(products < 0, -1, 1), axis=0).astype(np.float32)
    continuous = turns.copy()
    continuous[1:] *= signs[..., None]
    return continuous


def _changing(values: Float32Array, same: float) -> IntArray:
    """Return frames of values ``(F, K)`` but those between two of the same value."""
    steps = (np.abs(np.diff(values, axis=0)) > same).any(axis=1)
    if not steps.any():
        return np.zeros(1, np.int64)
    kept = np.append(True, steps) | np.append(steps, True)
    return np.flatnonzero(kept)
