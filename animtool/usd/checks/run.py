"""Run animtool's and USD's checks on a stage or a layer."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import field, replace
from pathlib import Path
from typing import Any, TypeAlias

from pxr import UsdSkel, UsdValidation

from animtool.core.errors import AnimtoolError, Fault, FormatError, Severity
from animtool.core.record import dataclass
from animtool.core.rules import finding
from animtool.usd.checks.animation import (
    check_animations,
    check_bindings,
    check_known_joints,
)
from animtool.usd.checks.checked_stage import CheckedStage
from animtool.usd.checks.extents import check_extents
from animtool.usd.checks.finite import (
    COVERED_CODES,
    check_finite,
    check_splines,
    check_types,
    check_uniform,
)
from animtool.usd.checks.points import check_instancers, check_points
from animtool.usd.checks.skeleton import check_physics_joints, check_skeletons
from animtool.usd.checks.skin import check_shapes, check_skins, check_targets
from animtool.usd.checks.stage_metadata import (
    check_assets,
    check_composition,
    check_range,
    check_rate_values,
    check_rates,
    check_units,
)
from animtool.usd.checks.takes import AnimationTake, animation_takes
from animtool.usd.checks.value_clips import check_value_clips
from animtool.usd.layers.dependencies import open_composed
from animtool.usd.layers.sdf import open_layer, usd_errors
from animtool.usd.layers.stderr import without_usd_warnings
from animtool.usd.rigs.prims import skeleton_rig, stored_data

# Keyword of animtool's validator in UsdValidation, so that it does not run twice.
ANIMTOOL_KEYWORD = "animtool"
# USD validators whose findings our checks report with more detail.
_COVERED_CHECKS = {
    "usdValidation:CompositionErrorTest",
    "usdUtilsValidators:MissingReferenceValidator",
}
_CODES_BY_VALIDATOR = {
    "usdSkelValidators:SkelBindingApiAppliedValidator": "USD236",
    "usdSkelValidators:SkelBindingApiValidator": "USD237",
    "usdGeomValidators:StageMetadataChecker": "USD258",
    "usdValidation:StageMetadataChecker": "USD259",
    "usdPhysicsValidators:PhysicsJointChecker": "USD270",
}
_UNAPPLIED_BINDING = re.compile(
    r"Found a UsdSkelBinding property \((.*?)\), but no SkelBindingAPI applied on the "
    r"prim <[^>]*>"
)
_CODES_BY_FAMILY = {
    "usdValidation": "USD280",
    "usdGeomValidators": "USD281",
    "usdShadeValidators": "USD282",
    "usdLuxValidators": "USD283",
    "usdPhysicsValidators": "USD284",
    "usdUtilsValidators": "USD285",
}


def check_with_usd(checked_stage: CheckedStage) -> Iterator[Fault]:
    """Run the UsdValidation validators that animtool's checks do not cover."""
    registry = UsdValidation.ValidationRegistry()
    names = [
        metadata.name
        for metadata in registry.GetAllValidatorMetadata()
        if not metadata.isSuite
        and metadata.name not in _COVERED_CHECKS
        and ANIMTOOL_KEYWORD not in metadata.GetKeywords()
    ]
    validators = registry.GetOrLoadValidatorsByName(names)
    errors = UsdValidation.ValidationContext(validators).Validate(checked_stage.stage)
    faults = [_usd_error_fault(error, checked_stage.stage) for error in errors]
    # They run in parallel and return findings in any order.
    yield from sorted(faults, key=lambda f: (f.code, f.where or "", f.message))


def _usd_error_fault(error: Any, stage: Any) -> Fault:
    validator = error.GetValidator().GetMetadata().name
    code = _CODES_BY_VALIDATOR.get(validator)
    if code is None:
        code = _CODES_BY_FAMILY.get(validator.partition(":")[0], "USD286")
    kinds = UsdValidation.ValidationErrorType
    severity = Severity.NOTE if error.GetType() == kinds.Info else None
    text = " ".join(error.GetMessage().split()).rstrip(".")
    # The file is named before the message, and so is what a known code is about.
    text = re.sub(r"Stage with root layer <[^>]*>", "the stage", text)
    text = re.sub(
        r"^UsdSkelBindingAPI applied on prim: <[^>]*>, which is not .*",
        "the prim has SkelBindingAPI, but is not below a SkelRoot",
        text,
    )
    if code == "USD259":
        name = stage.GetRootLayer().defaultPrim
        text = "the stage has no defaultPrim"
        text = f"the defaultPrim {name!r} does not exist" if name else text
    message = text if validator in _CODES_BY_VALIDATOR else f"{validator}: {text}"
    return finding(code, _error_location(error), message, severity)


def _error_location(error: Any) -> str:
    for site in error.GetSites():
        if site.IsProperty():
            return str(site.GetProperty().GetPath())
        if site.IsPrim():
            return str(site.GetPrim().GetPath())
        if site.IsValidSpecInLayer():
            spec = site.GetPropertySpec() or site.GetPrimSpec()
            return str(spec.path) if spec else "/"
    return "/"


Check: TypeAlias = Callable[[CheckedStage], Iterator[Fault]]

# Checks that read no samples; the others need valid rates.
STATIC_CHECKS: tuple[Check, ...] = (check_rate_values, check_composition, check_units)
SAMPLE_CHECKS: tuple[Check, ...] = (
    check_assets,
    check_rates,
    check_range,
    check_bindings,
    check_skeletons,
    check_animations,
    check_known_joints,
    check_skins,
    check_targets,
    check_shapes,
    check_points,
    check_instancers,
    check_extents,
    check_physics_joints,
    check_splines,
    check_uniform,
    check_value_clips,
)


@dataclass(frozen=True, slots=True)
class Inspection:
    """Findings in a USD layer, and its animations."""

    faults: list[Fault]  # findings in the layer and the layers it composes
    # Its animations, for rules on motion.
    takes: list[AnimationTake] = field(default_factory=list)
    has_only_overs: bool = False  # whether the rig is in another file


def inspect_layer(path: Path | str) -> Inspection:
    """Return the takes of a USD layer, and all findings in its composed stage.

    If the layer cannot be opened, that is the only finding. USD's own warnings about it
    are not printed, since the findings cover them.
    """
    path = Path(path)
    try:
        with without_usd_warnings(), usd_errors(path):
            checked_stage = CheckedStage(open_composed(open_layer(path), path))
            findings = [
                *_all_faults(checked_stage),
                *_run_check(check_with_usd, checked_stage),
            ]
            # Without a rate, a unit or an up axis, motion has no speed or size.
            has_units = not any(
                fault.code in {"USD253", "USD260"} for fault in findings
            )
            takes = _valid_takes(checked_stage, path) if has_units else []
            if has_units and all(fault.code != "USD267" for fault in findings):
                findings += _resized_rigs(checked_stage, path)
    except FormatError as error:
        return Inspection(list(error.faults))
    faults = [replace(fault, path=str(path)) for fault in _distinct_faults(findings)]
    return Inspection(faults, takes, checked_stage.has_only_overs)


def _resized_rigs(checked_stage: CheckedStage, path: Path) -> list[Fault]:
    """Return warnings about Skeletons in another unit than they were written in."""
    notices: list[Fault] = []
    for skeleton in checked_stage.prims_of_type(UsdSkel.Skeleton):
        if not stored_data(skeleton.GetPrim()).get("rig"):
            continue
        from animtool.usd.rigs.stored import merge_rig

        try:
            usd_rig = skeleton_rig(skeleton, path, is_animated=False)
            _, rig_notices = merge_rig(usd_rig.rig, skeleton, usd_rig.tokens, path)
        except AnimtoolError:  # the findings contain the reason
            continue
        notices += [notice for notice in rig_notices if notice.code == "USD126"]
    return notices


def check_layer(path: Path | str) -> list[Fault]:
    """Return all findings in a USD layer; see `inspect_layer`."""
    return inspect_layer(path).faults


def check_stage(stage: Any) -> list[Fault]:
    """Return the findings of animtool's checks on a stage."""
    return _distinct_faults(_all_faults(CheckedStage(stage)))


def _all_faults(checked_stage: CheckedStage) -> list[Fault]:
    faults = [
        fault for check in STATIC_CHECKS for fault in _run_check(check, checked_stage)
    ]
    # With an invalid rate, samples have no time.
    if all(fault.code != "USD253" for fault in faults):
        faults += [
            fault
            for check in SAMPLE_CHECKS
            for fault in _run_check(check, checked_stage)
        ]
    covered_locations = {fault.where for fault in faults if fault.code in COVERED_CODES}
    finite_faults = _run_check(check_finite, checked_stage)
    return faults + [
        fault for fault in finite_faults if fault.where not in covered_locations
    ]


def _valid_takes(checked_stage: CheckedStage, path: Path) -> list[AnimationTake]:
    """Return a stage's animations as takes; empty if an attribute has a wrong type."""
    try:
        return animation_takes(checked_stage, path)
    except (FormatError, AttributeError, IndexError, TypeError, ValueError):
        if any(True for _ in check_types(checked_stage)):
            return []
        raise


def _run_check(check: Check, checked_stage: CheckedStage) -> Iterator[Fault]:
    """Yield the findings of a check, including errors that USD raises.

    The check stops at a value of the wrong type; the findings report that type.
    """
    try:
        with usd_errors(Path(checked_stage.stage.GetRootLayer().identifier)):
            yield from check(checked_stage)
    except FormatError as error:
        yield from (replace(fault, where="/") for fault in error.faults)
    except (AttributeError, IndexError, TypeError, ValueError):
        type_faults = list(check_types(checked_stage))
        if not type_faults:
            raise
        yield from type_faults


def _distinct_faults(faults: list[Fault]) -> list[Fault]:
    """Return faults without those that repeat an earlier one at the same location.

    Per code and location the first message is kept: a validator of USD may repeat a
    finding of ours.
    """
    is_usd_report: dict[tuple[str, str | None], bool] = {}
    distinct_faults = []
    for fault in faults:
        is_from_usd = fault.message.partition(":")[0].lower().startswith("usd")
        key = (fault.code, fault.where)
        if is_from_usd and key in is_usd_report and not is_usd_report[key]:
            continue
        is_usd_report.setdefault(key, is_from_usd)
        distinct_faults.append(fault)
    return distinct_faults
