"""What a rig's simulations move, of the rig's text and of what USD holds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from animtool.rig.parts import AttachKind, Attachment, HeldArray
from animtool.rig.skeleton import Rig
from animtool.usd.skinned import unique_name


def joined_attachments(
    rig: Rig, strands: Mapping[str, Attachment], pins: Mapping[str, Any]
) -> tuple[tuple[Attachment, ...], list[str]]:
    """Return a rig's attachments with their arrays, and names of those left out.

    Strands are as USD has them; others than the rig's stand last. What is left out has
    lost its mesh or curves, or the vertices that it pins.

    Args:
        rig: Its meshes are those of USD, its attachments have no arrays yet.
        strands: Those of USD, by name.
        pins: Vertices by the name of a cloth, as customData has them.
    """
    others = dict(strands)
    counts = {mesh.name: len(mesh.points.load()) for mesh in rig.meshes}
    made: list[Attachment] = []
    lost: list[str] = []
    for entry in rig.attach:
        if entry.kind == AttachKind.STRANDS and entry.name in others:
            made.append(others.pop(entry.name))
        elif entry.kind == AttachKind.CLOTH and _fits(entry, counts, pins):
            held = np.array(pins[entry.name], float) if entry.name in pins else None
            made.append(replace(entry, pins=None if held is None else HeldArray(held)))
        elif entry.kind in {AttachKind.STRANDS, AttachKind.CLOTH}:
            lost.append(entry.name)
        else:
            made.append(entry)
    used = {entry.name for entry in made}
    made += [
        replace(entry, name=unique_name(entry.name, used)) for entry in others.values()
    ]
    return tuple(made), lost


def _fits(entry: Attachment, counts: dict[str, int], pins: Mapping[str, Any]) -> bool:
    """Return whether a cloth has its mesh, and that the vertices of its pins."""
    given = np.array(pins.get(entry.name, ()))
    count = counts.get(entry.mesh, 0)
    whole = given.ndim == 1 and (not len(given) or given.dtype.kind in "iu")
    return bool(count and whole and ((given >= 0) & (given < count)).all())
