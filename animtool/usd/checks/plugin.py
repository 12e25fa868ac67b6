"""Registers our checks as a validator of `pxr.UsdValidation`.

USD loads this module itself if ``PXR_PLUGINPATH_NAME`` contains its folder, which has
``plugInfo.json``. In Python, `register` works without it. Errors have our codes as
names.
"""

from __future__ import annotations

from typing import Any

from pxr import Sdf, UsdValidation

from animtool.core.errors import Fault, Severity
from animtool.usd.checks.run import ANIMTOOL_KEYWORD, check_stage

# Same name as in plugInfo.json; `register` also works without that file.
PLUGIN_NAME = "animtool.usd.checks.plugin:Checks"
VALIDATOR_NAME = "animtool:Checks"

_ERROR_TYPES = {
    Severity.ERROR: UsdValidation.ValidationErrorType.Error,
    Severity.WARNING: UsdValidation.ValidationErrorType.Warn,
    Severity.NOTE: UsdValidation.ValidationErrorType.Info,
}


def register() -> Any:
    """Return our validator, registered with USD on first use."""
    registry = UsdValidation.ValidationRegistry()
    for name in (PLUGIN_NAME, VALIDATOR_NAME):
        if registry.HasValidator(name):
            return registry.GetOrLoadValidatorByName(name)
    metadata = UsdValidation.ValidatorMetadata(
        name=VALIDATOR_NAME,
        keywords=[ANIMTOOL_KEYWORD],
        doc="Checks of animtool for USD stages.",
    )
    registry.RegisterStageValidator(metadata, validate)
    return registry.GetOrLoadValidatorByName(VALIDATOR_NAME)


def validate(stage: Any, _times: Any) -> list[Any]:
    """Return the findings of our checks on a stage as UsdValidation errors."""
    return [_validation_error(stage, fault) for fault in check_stage(stage)]


def _validation_error(stage: Any, fault: Fault) -> Any:
    path = Sdf.Path(fault.where or "/")
    if not stage.GetObjectAtPath(path):
        path = path.GetPrimPath()
    site = UsdValidation.ValidationErrorSite(stage, path)
    text = f"{fault.message}; {fault.hint}" if fault.hint else fault.message
    return UsdValidation.ValidationError(
        fault.code, _ERROR_TYPES[fault.severity], [site], text
    )


def _register_plugin() -> None:
    """Register the function of the validator declared in plugInfo.json."""
    registry = UsdValidation.ValidationRegistry()
    if registry.GetValidatorMetadata(PLUGIN_NAME) is not None:
        registry.RegisterPluginStageValidator(PLUGIN_NAME, validate)


_register_plugin()
