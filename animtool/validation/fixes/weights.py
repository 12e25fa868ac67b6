"""Weights of skins, summed to 1 in a file of their own."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from animtool.documents.edit import Put
from animtool.documents.references import split_reference
from animtool.errors import Fault, excerpt
from animtool.output_names import name_problem
from animtool.rig.parts import ArrayRef
from animtool.validation.fixes.mend import Mend, NotMendedError
from animtool.validation.fixes.places import place_of
from animtool.validation.subjects.rig import RigSubject
from animtool.validation.subjects.subject import Opened


def summed(opened: Opened, fault: Fault) -> Mend:
    """Return the file with weights that are divided by their sums, in a new npz.

    That is what every reader of the file does with them. The npz that holds them now
    may be another rig's too, and stays as it is.
    """
    rig: RigSubject = opened.subject
    place = place_of(fault)
    skin = rig.rig.meshes[place[1]].skin
    if "from" in rig.document.value or skin is None:
        raise NotMendedError("the mesh comes from another file")
    weights = skin.weights
    if not isinstance(weights, ArrayRef):
        raise NotMendedError("the weights are in no npz file")
    path = _free(weights.path, weights.key)
    name, _ = split_reference(weights.text, weights.key)
    text = f"{name[: -len(weights.path.name)]}{path.name}#{weights.key}"
    said = f"writes {path.name} with the weights divided by their sums"
    arrays = {path: {weights.key: _divided(weights)}}
    return Mend(said, (Put(place, text),), arrays)


def _free(path: Path, key: str) -> Path:
    """Return a file beside another that is not there yet.

    Raises:
        NotMendedError: The key cannot be a part of its name.
    """
    problem = name_problem(f"{path.stem}_{key}.npz")
    if problem is not None:
        raise NotMendedError(f"the name of the array, {excerpt(key)}, {problem}")
    number, found = 2, path.with_name(f"{path.stem}_{key}.npz")
    while found.exists():
        found = path.with_name(f"{path.stem}_{key}_{number}.npz")
        number += 1
    return found


def _divided(weights: ArrayRef) -> npt.NDArray[np.float32]:
    values = weights.load()
    return np.asarray(values / values.sum(axis=1, keepdims=True), np.float32)
