"""What `pxr.UsdValidation` finds, under codes of ours."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from pxr import UsdValidation

from animtool.errors import Fault, Severity
from animtool.rules import finding
from animtool.usd.checks.subject import Subject

# Of ours inside of UsdValidation, which need not run twice.
OWN_KEYWORD = "animtool"
# What ours find too, with the prim: no need to ask.
_COVERED = {
    "usdValidation:CompositionErrorTest",
    "usdUtilsValidators:MissingReferenceValidator",
}
_CODES = {
    "usdSkelValidators:SkelBindingApiAppliedValidator": "USD236",
    "usdSkelValidators:SkelBindingApiValidator": "USD237",
    "usdGeomValidators:StageMetadataChecker": "USD258",
    "usdValidation:StageMetadataChecker": "USD259",
    "usdPhysicsValidators:PhysicsJointChecker": "USD270",
}
_FAMILIES = {
    "usdValidation": "USD280",
    "usdGeomValidators": "USD281",
    "usdShadeValidators": "USD282",
    "usdLuxValidators": "USD283",
    "usdPhysicsValidators": "USD284",
    "usdUtilsValidators": "USD285",
}


def check_with_usd(subject: Subject) -> Iterator[Fault]:
    """Run every validator that UsdValidation has, but for those that ours cover."""
    registry = UsdValidation.ValidationRegistry()
    names = [
        metadata.name
        for metadata in registry.GetAllValidatorMetadata()
        if not metadata.isSuite
        and metadata.name not in _COVERED
        and OWN_KEYWORD not in metadata.GetKeywords()
    ]
    validators = registry.GetOrLoadValidatorsByName(names)
    found = UsdValidation.ValidationContext(validators).Validate(subject.stage)
    faults = [_fault(error) for error in found]
    # They run in parallel and come in any order.
    yield from sorted(faults, key=lambda f: (f.code, f.where or "", f.message))


def _fault(error: Any) -> Fault:
    validator = error.GetValidator().GetMetadata().name
    code = _CODES.get(validator)
    if code is None:
        code = _FAMILIES.get(validator.partition(":")[0], "USD286")
    kinds = UsdValidation.ValidationErrorType
    note = Severity.NOTE if error.GetType() == kinds.Info else None
    message = f"{validator}: {' '.join(error.GetMessage().split()).rstrip('.')}"
    return finding(code, _where(error), message, note)


def _where(error: Any) -> str:
    for site in error.GetSites():
        if site.IsProperty():
            return str(site.GetProperty().GetPath())
        if site.IsPrim():
            return str(site.GetPrim().GetPath())
        if site.IsValidSpecInLayer():
            spec = site.GetPropertySpec() or site.GetPrimSpec()
            return str(spec.path) if spec else "/"
    return "/"
