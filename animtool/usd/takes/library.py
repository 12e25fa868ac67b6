"""Writes and reads clip libraries: takes that variants bind to one character.

Every take is a SkelAnimation ``Anim_{take}`` next to the Skeleton. The variant set
``take`` of the model binds one: a variant has ``skel:animationSource``, the SkelRoot's
extent and, with root motion, its transform. None of these is authored
outside the variants, where it would be stronger. ``customData`` of a SkelAnimation has
the frames of the take::

    animtool = { dictionary take = { string name, timecode start, timecode end } }
"""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

from pxr import Sdf, Usd

from animtool.core.arguments import argument
from animtool.core.errors import Fault, OptionError, OutputError, excerpt, listed
from animtool.core.names import most_similar
from animtool.core.rates import MAX_FRAME_NUMBER
from animtool.core.record import dataclass
from animtool.usd.layers.names import TAKE_SET, RigPaths, replace_prefix
from animtool.usd.layers.sdf import new_layer, open_layer, usd_errors
from animtool.usd.rigs.prims import (
    find_skeletons,
    open_stage,
    search_root,
    self_and_ancestors,
)

# Direct opinions of a layer stack are stronger than its variants, in any layer order.
STRONGER_HINT = (
    "a binding in the rig is stronger than a variant in a separate layer: reference "
    f"the rig from a shot, and name its prim with {argument('prim_path')}"
)


def take_paths(paths: RigPaths, name: str) -> RigPaths:
    """Return the prim paths of a take; its binding is inside its variant.

    An empty name stands for a file with a single take, which has no variants.

    >>> take_paths(RigPaths.from_model("/hero"), "run").binding
    '/hero{take=run}Rig'
    """
    if not name:
        return paths
    variant = str(Sdf.Path(paths.model).AppendVariantSelection(TAKE_SET, name))
    return replace(
        paths,
        root=replace_prefix(paths.root, paths.model, variant),
        binding=replace_prefix(paths.binding, paths.model, variant),
        animation=f"{paths.animation}_{name}",
    )


def author_take_metadata(
    layer: Any, animation: str, name: str, first: Fraction, last: Fraction
) -> None:
    """Author a take's source name and frames on its SkelAnimation."""
    # They are time codes, so that layer offsets apply to them.
    start_code, end_code = Sdf.TimeCode(float(first)), Sdf.TimeCode(float(last))
    take = {"name": name, "start": start_code, "end": end_code}
    layer.GetPrimAtPath(animation).SetInfo("customData", {"animtool": {"take": take}})


def stored_take_range(animation: Any) -> tuple[Fraction, Fraction] | None:
    """Return the first and last frame of a SkelAnimation; None if not authored."""
    data = animation.GetPrim().GetCustomDataByKey("animtool:take")
    if not isinstance(data, dict):
        return None
    range_values = [data.get("start"), data.get("end")]
    range_values = [
        value.GetValue() if isinstance(value, Sdf.TimeCode) else value
        for value in range_values
    ]
    numbers = [
        float(value) for value in range_values if isinstance(value, (int, float))
    ]
    if len(numbers) < 2 or not all(abs(value) <= MAX_FRAME_NUMBER for value in numbers):
        return None
    first_code, last_code = (
        Fraction(value).limit_denominator(1_000_000) for value in numbers
    )
    return (first_code, last_code) if first_code <= last_code else None


@dataclass(frozen=True, slots=True)
class TakeSet:
    """The takes of a character on a stage."""

    prim: Any  # the prim with the variant set
    names: tuple[str, ...]  # names of the takes
    selected_name: str  # name of the bound take


def find_take_set(start_prim: Any) -> TakeSet | None:
    """Return the take set of a prim or its nearest ancestor with one.

    Prims inside instances cannot select variants and are skipped.
    """
    for prim in self_and_ancestors(start_prim):
        if not prim.IsInstanceProxy() and prim.GetVariantSets().HasVariantSet(TAKE_SET):
            variant_set = prim.GetVariantSet(TAKE_SET)
            names = tuple(variant_set.GetVariantNames())
            return TakeSet(prim, names, str(variant_set.GetVariantSelection()))
    return None


def select_take(take_set: TakeSet | None, name: str, file_path: str) -> TakeSet:
    """Select a take in the stage's session layer; return the updated take set."""
    if take_set is None:
        message = f"unknown take {excerpt(name)}: the file is not a clip library"
        hint = f"a library has a variant set {TAKE_SET!r}"
        raise OptionError(Fault("USD031", message, file_path, (), hint))
    if name not in take_set.names:
        similar_name = most_similar(name, take_set.names)
        hint = f"did you mean {similar_name!r}? " if similar_name else ""
        hint += f"the takes: {listed(take_set.names, 40)}"
        message = f"unknown take {excerpt(name)}"
        raise OptionError(Fault("USD031", message, file_path, (), hint))
    stage = take_set.prim.GetStage()
    with Usd.EditContext(stage, stage.GetSessionLayer()):
        take_set.prim.GetVariantSet(TAKE_SET).SetVariantSelection(name)
    return replace(take_set, selected_name=name)


def check_variant(
    stage: Any, layer: Any, paths: RigPaths, file_path: str | None
) -> None:
    """Refuse a variant whose values stronger opinions override (USD032)."""
    for prim_path in sorted({paths.root, paths.binding}):
        spec = layer.GetPrimAtPath(prim_path)
        for property_spec in spec.properties if spec else ():
            path = property_spec.path.StripAllVariantSelections()
            property_stack = stage.GetPropertyAtPath(path).GetPropertyStack(
                Usd.TimeCode.Default()
            )
            if property_stack and property_stack[0].path != property_spec.path:
                message = f"{path} of the rig is stronger than that of a variant"
                raise OutputError(
                    Fault("USD032", message, file_path, (), STRONGER_HINT)
                )


MAX_LISTED_TAKES = 40


def check_can_add_take(
    path: Path, take_name: str, prim_path: str | None, *, overwrite: bool
) -> None:
    """Refuse a file that a take cannot be added to (SCN050, SCN051).

    ``overwrite`` says whether a take of that name may be replaced.
    """
    with usd_errors(path):
        stage = open_stage(path)
        skeletons = find_skeletons(stage, search_root(stage, prim_path))
        take_set = find_take_set(skeletons[0].GetPrim()) if skeletons else None
    if take_set is None:
        message = "is not a clip library that a take can be added to"
        hint = f"a library has a skeleton below a variant set {TAKE_SET!r}"
        raise OptionError(Fault("SCN051", message, str(path), (), hint))
    if take_name not in take_set.names:
        return
    if not overwrite:
        message = (
            f"already has a take {take_name!r}, of "
            f"{listed(take_set.names, MAX_LISTED_TAKES)}"
        )
        hint = f"{argument('overwrite', True)} replaces it; take: chooses another name"
        raise OptionError(Fault("SCN050", message, str(path), (), hint))
    variant = take_set.prim.GetPath().AppendVariantSelection(TAKE_SET, take_name)
    if stage.GetRootLayer().GetPrimAtPath(variant) is None:
        message = f"has the take {take_name!r} in another layer, which is not written"
        hint = "write to that layer instead"
        raise OptionError(Fault("SCN051", message, str(path), (), hint))


def merge_take(path: Path, layer: Any, paths: RigPaths, name: str) -> Any:
    """Return a library layer with a take of another layer added or replaced.

    The other takes and the selected take stay unchanged.
    """
    merged_layer = new_layer(path)
    merged_layer.TransferContent(open_layer(path))
    model = Sdf.Path(paths.model)
    animation = Sdf.Path(f"{paths.animation}_{name}")
    variant = model.AppendVariantSelection(TAKE_SET, name)
    with Sdf.ChangeBlock():
        for spec_path in (animation.GetParentPath(), model):
            if merged_layer.GetPrimAtPath(spec_path) is None:
                Sdf.CreatePrimInLayer(merged_layer, spec_path)
        _create_variant(merged_layer.GetPrimAtPath(model), name)
        Sdf.CopySpec(layer, animation, merged_layer, animation)
        Sdf.CopySpec(layer, variant, merged_layer, variant)
    merged_layer.startTimeCode = min(merged_layer.startTimeCode, layer.startTimeCode)
    merged_layer.endTimeCode = max(merged_layer.endTimeCode, layer.endTimeCode)
    return merged_layer


def _create_variant(model: Any, name: str) -> None:
    """Create a variant and its set if missing."""
    if TAKE_SET not in model.variantSets:
        model.variantSetNameList.prependedItems.append(TAKE_SET)
        Sdf.VariantSetSpec(model, TAKE_SET)
    variants = model.variantSets[TAKE_SET]
    if name not in variants.variants:
        Sdf.VariantSpec(variants, name)
