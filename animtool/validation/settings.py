"""``[tool.animtool.validate]`` of a project."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from animtool.config import find_config
from animtool.errors import Fault, OptionError, Severity
from animtool.validation.options import ValidateOptions, check_codes
from animtool.validation.profiles import load_profile

_LISTS = ("select", "ignore")


def settings_of(path: Path) -> ValidateOptions:
    """Return what the project of a file sets.

    Raises:
        OptionError: The settings are malformed (CFG001 to CFG003), or name a code
            that there is none of (VAL005).
    """
    config = find_config(path)
    return _options(config.validate, str(config.path))


def _options(table: Any, path: str) -> ValidateOptions:
    lists: dict[str, tuple[str, ...]] = {}
    for name in table:
        if name not in {*_LISTS, "severity", "profile"}:
            message = f"unknown setting validate.{name}"
            hint = f"allowed: {', '.join(_LISTS)}, severity, profile"
            raise OptionError(Fault("CFG002", message, path, (), hint))
    for name in _LISTS:
        codes = table.get(name, [])
        if not isinstance(codes, list) or not all(isinstance(c, str) for c in codes):
            message = f"validate.{name} is {codes!r}, not a list of codes"
            raise OptionError(Fault("CFG003", message, path))
        lists[name] = tuple(codes)
    given = table.get("severity", {})
    if not isinstance(given, dict):
        message = f"validate.severity is {given!r}, not a table of codes"
        raise OptionError(Fault("CFG003", message, path))
    severities = {}
    for code, name in given.items():
        if name not in list(Severity):
            message = f"validate.severity.{code} is {name!r}"
            hint = f"allowed: {', '.join(Severity)}"
            raise OptionError(Fault("CFG003", message, path, (), hint))
        severities[code] = Severity(name)
    profile = table.get("profile", "")
    if not isinstance(profile, str):
        message = f"validate.profile is {profile!r}, not a name or file"
        raise OptionError(Fault("CFG003", message, path))
    levels = load_profile(profile, Path(path).parent) if profile else {}
    options = ValidateOptions(
        lists["select"],
        lists["ignore"],
        severities,
        profile=profile,
        levels=levels,
    )
    check_codes(options, path)
    return options
