"""Meshes, skins and shapes of a rig, and names that USD cannot tell apart."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from itertools import chain
from typing import TYPE_CHECKING

import numpy as np

from animtool.documents.arrays import Archives
from animtool.errors import Fault, counted
from animtool.rig.parts import Mesh, Shape
from animtool.validation.subjects.rig import RigSubject

if TYPE_CHECKING:
    from animtool.validation.subjects.capture import TakeSubject
    from animtool.validation.subjects.rig import RigSubject


# Lists of a rig file whose names are names in USD.
GROUPS = ("joints", "meshes", "shapes")
HINT = "the second gets a number there; rename one"


def names_apart(subject: RigSubject | TakeSubject) -> Iterator[Fault]:
    """Yield names of a rig, or of joints in a capture, that become one (RIG219)."""
    if isinstance(subject, RigSubject):
        for key in GROUPS:
            for name, message in _collisions(names_in(subject, key)):
                yield subject.fault("RIG219", subject.at(key, name), message, HINT)
        return
    for name, message in _collisions(subject.take.rig.names):
        yield subject.fault("RIG219", name, message, HINT)


def not_in_usd(rig: RigSubject) -> Iterator[Fault]:
    """Yield lists with names that are others in USD (RIG221)."""
    if "from" in rig.document.value:
        return
    for key in GROUPS:
        names = [name for name in names_in(rig, key) if legal(name) != name]
        if names:
            one = len(names) == 1
            message = (
                f"{counted(len(names), 'name')} of {key} {'is' if one else 'are'} "
                f"written otherwise in USD: {names[0]!r} as {legal(names[0])!r}"
            )
            hint = "letters, digits and underscores stay as they are"
            yield rig.fault("RIG221", rig.at(key, names[0]), message, hint)


def names_in(rig: RigSubject, key: str) -> list[str]:
    """Return the names of one of `GROUPS`."""
    return [entry.name for entry in getattr(rig.rig, key)]


def _collisions(names: Sequence[str]) -> Iterator[tuple[str, str]]:
    """Yield each name that another before it becomes, and what to say of it."""
    first: dict[str, str] = {}
    for name in names:
        shown = legal(name)
        if shown in first:
            yield name, f"{name!r} and {first[shown]!r} both become {shown!r} in USD"
        first.setdefault(shown, name)


def legal(name: str) -> str:
    """Return a name with `_` for whatever cannot stand in the name of a prim."""
    plain = re.sub(r"\W", "_", name)
    return f"_{plain}" if plain[:1].isdigit() else plain


# Sums of weights that were rounded to a byte each are within it [1].
WEIGHT_SLACK = 0.02
# Engines take four or eight joints a vertex.
MAX_INFLUENCES = 8
# A mesh is seldom larger or smaller than its skeleton by as much [1].
SIZE_RATIO = 30.0
# Fewer joints are a prop that may be anywhere in a large mesh.
MIN_JOINTS = 3


def no_effect(rig: RigSubject) -> Iterator[Fault]:
    """Yield shapes that move no point (RIG209)."""
    used = {name for shape in rig.rig.shapes for name in shape.combine}
    with Archives() as archives:
        for shape in rig.rig.shapes:
            # Without a mesh it is a weight that something else reads.
            if not shape.mesh or _acts(shape, archives):
                continue
            if shape.deltas is None and shape.name in used:
                continue
            at = rig.at("shapes", shape.name)
            message = f"{shape.name!r} moves no point of {shape.mesh!r}"
            yield rig.fault("RIG209", at, message, "give it deltas, or leave it out")


def _acts(shape: Shape, archives: Archives) -> bool:
    between = chain.from_iterable((s.deltas, s.normals) for s in shape.inbetweens)
    arrays = (shape.deltas, shape.normals, *between)
    return any(array.load(archives).any() for array in arrays if array is not None)


def weight_sums(rig: RigSubject) -> Iterator[Fault]:
    """Yield skins whose weights are not summed to 1 (RIG210)."""
    with Archives() as archives:
        for mesh in rig.rig.meshes:
            if mesh.skin is None:
                continue
            off = np.abs(mesh.skin.weights.load(archives).sum(axis=1) - 1.0)
            wrong = np.flatnonzero(off > WEIGHT_SLACK)
            if not len(wrong):
                continue
            worst = int(off.argmax())
            total = float(mesh.skin.weights.load(archives)[worst].sum())
            points = counted(len(wrong), "point")
            message = (
                f"the weights of {points} of {mesh.name!r} are not summed to 1, most "
                f"of all those of {worst}: {total:.4g}"
            )
            hint = "divide them by their sums, as every reader does"
            at = (*rig.at("meshes", mesh.name), "skin", "weights")
            yield rig.fault("RIG210", at, message, hint)


def many_influences(rig: RigSubject) -> Iterator[Fault]:
    """Yield skins with more joints a point than engines take (RIG211)."""
    with Archives() as archives:
        for mesh in rig.rig.meshes:
            if mesh.skin is None:
                continue
            counts = np.count_nonzero(mesh.skin.weights.load(archives), axis=1)
            wrong = np.flatnonzero(counts > MAX_INFLUENCES)
            if not len(wrong):
                continue
            message = (
                f"{counted(len(wrong), 'point')} of {mesh.name!r} follow more than "
                f"{MAX_INFLUENCES} joints, point {wrong[0]} follows {counts[wrong[0]]}"
            )
            hint = f"keep the {MAX_INFLUENCES} largest weights"
            at = (*rig.at("meshes", mesh.name), "skin", "weights")
            yield rig.fault("RIG211", at, message, hint)


def mesh_size(rig: RigSubject) -> Iterator[Fault]:
    """Yield skinned meshes of quite another size than the skeleton (RIG218)."""
    if len(rig.rig.joints) < MIN_JOINTS or not rig.size:
        return
    with Archives() as archives:
        sizes = {
            mesh.name: _diagonal(mesh, archives) * rig.rig.meters_per_unit
            for mesh in rig.rig.meshes
            if mesh.skin is not None and mesh.geom_bind is None
        }
    largest = max(sizes.values(), default=0.0)
    if largest and not rig.size / SIZE_RATIO <= largest <= rig.size * SIZE_RATIO:
        name = max(sizes, key=lambda name: sizes[name])
        message = (
            f"{name!r} measures {largest:.3g} m, and the joints at rest "
            f"{rig.size:.3g} m"
        )
        hint = "points are in the file's unit, as joints are; or write geom_bind"
        at = (*rig.at("meshes", name), "points")
        yield rig.fault("RIG218", at, message, hint)


def _diagonal(mesh: Mesh, archives: Archives) -> float:
    points = mesh.points.load(archives)
    if not len(points):
        return 0.0
    return float(np.linalg.norm(points.max(axis=0) - points.min(axis=0)))
