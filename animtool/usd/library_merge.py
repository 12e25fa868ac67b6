"""Adding a take to a clip library that is there, or replacing one of it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pxr import Sdf

from animtool.errors import Fault, OptionError, listed
from animtool.usd.layers import find_layer, new_layer, usd_errors
from animtool.usd.library import TAKE_SET, find_take_set
from animtool.usd.paths import RigPaths
from animtool.usd.rig_prims import find_skeletons, open_stage, prim_below

MAX_NAMED = 40


def check_library(
    path: Path, name: str, prim_path: str | None, *, overwrite: bool
) -> None:
    """Refuse a file that a take cannot be added to.

    Args:
        path: The file, which exists.
        name: Of the take.
        prim_path: The character, where there are several.
        overwrite: Whether a take of that name may be replaced.

    Raises:
        FormatError: It is no USD file.
        OptionError: It is no clip library, or the take is one of a sublayer (SCN051);
            or it has such a take, which may not be replaced (SCN050).
    """
    with usd_errors(path):
        stage = open_stage(path)
        skeletons = find_skeletons(stage, prim_below(stage, prim_path))
        takes = find_take_set(skeletons[0].GetPrim()) if skeletons else None
    if takes is None:
        message = "is no clip library, to which a take could be added"
        hint = f"a library has a skeleton below a variant set {TAKE_SET!r}"
        raise OptionError(Fault("SCN051", message, str(path), (), hint))
    if name not in takes.names:
        return
    if not overwrite:
        message = f"has a take {name!r} already, of {listed(takes.names, MAX_NAMED)}"
        hint = "--overwrite replaces it; take: names another"
        raise OptionError(Fault("SCN050", message, str(path), (), hint))
    variant = takes.prim.GetPath().AppendVariantSelection(TAKE_SET, name)
    if stage.GetRootLayer().GetPrimAtPath(variant) is None:
        message = f"has the take {name!r} in another layer, which is not written"
        hint = "name the layer itself"
        raise OptionError(Fault("SCN051", message, str(path), (), hint))


def merged_library(path: Path, made: Any, paths: RigPaths, name: str) -> Any:
    """Return a library with a take of another layer added, or replaced by it.

    Every other take, and what it selects, stays as it is.

    Args:
        path: The library.
        made: A layer over it that has the take.
        paths: The character's prims.
        name: Of the take.
    """
    whole = new_layer(path)
    whole.TransferContent(find_layer(path))
    model = Sdf.Path(paths.model)
    animation = Sdf.Path(f"{paths.animation}_{name}")
    variant = model.AppendVariantSelection(TAKE_SET, name)
    with Sdf.ChangeBlock():
        for spot in (animation.GetParentPath(), model):
            if whole.GetPrimAtPath(spot) is None:
                Sdf.CreatePrimInLayer(whole, spot)
        _make_variant(whole.GetPrimAtPath(model), name)
        Sdf.CopySpec(made, animation, whole, animation)
        Sdf.CopySpec(made, variant, whole, variant)
    whole.startTimeCode = min(whole.startTimeCode, made.startTimeCode)
    whole.endTimeCode = max(whole.endTimeCode, made.endTimeCode)
    return whole


def _make_variant(model: Any, name: str) -> None:
    """Make sure of a variant, and of the set that it is in."""
    if TAKE_SET not in model.variantSets:
        model.variantSetNameList.prependedItems.append(TAKE_SET)
        Sdf.VariantSetSpec(model, TAKE_SET)
    found = model.variantSets[TAKE_SET]
    if name not in found.variants:
        Sdf.VariantSpec(found, name)
