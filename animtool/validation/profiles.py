"""Severity profiles: the severities of codes for a purpose."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from animtool.core.config import parse_toml
from animtool.core.errors import Fault, FormatError, OptionError, Severity
from animtool.core.files.reading import MAX_TEXT_BYTES, read_input
from animtool.core.names import name_hint
from animtool.core.record import dataclass
from animtool.core.rules import all_rules, current_codes

# Severity by code or prefix; None disables a code.
Levels = Mapping[str, Severity | None]

OFF_WORD = "off"
_PROFILE_KEYS = ("profile", "extends", "severity")
_VERSION = "animtool/1"
_ERROR, _WARNING, _NOTE = Severity.ERROR, Severity.WARNING, Severity.NOTE


@dataclass(frozen=True, slots=True)
class SeverityProfile:
    """A named set of severities for a kind of delivery."""

    about: str  # one-line description of its purpose
    levels: Levels  # severities that replace those of the rules


PROFILES: dict[str, SeverityProfile] = {
    "default": SeverityProfile("each code's own severity, also for layers", {}),
    "asset": SeverityProfile(
        "a published rig or asset: metadata needed to open it must be present",
        dict.fromkeys(
            (
                *("MOT213", "MOT215", "MOT220", "USD227", "USD228", "USD229"),
                *("USD232", "USD237", "USD258", "USD259", "USD262", "USD263"),
            ),
            _ERROR,
        ),
    ),
    "layer": SeverityProfile(
        "an animation layer over a rig elsewhere: the stage metadata comes from the "
        "shot",
        {
            "MOT217": _NOTE,
            "USD237": None,
            "USD250": None,
            "USD251": _NOTE,
            "USD255": _NOTE,
            "USD258": None,
            "USD259": None,
        },
    ),
    "shot": SeverityProfile(
        "the stage of a shot: its time must be right; its assets belong to others",
        {
            "MOT215": _NOTE,
            "MOT217": _NOTE,
            "MOT220": _NOTE,
            "MOT221": None,
            "USD227": _NOTE,
            "USD229": _NOTE,
            "RIG209": None,
            "USD250": _NOTE,
            "USD252": _ERROR,
            "USD255": _ERROR,
            "USD256": _ERROR,
            "USD257": _ERROR,
            "USD259": _NOTE,
        },
    ),
    "vendor": SeverityProfile(
        "a file delivered by others: losses are warnings, the rest are notes",
        {
            "USD2": _NOTE,
            # UsdSkel ignores or misreads files with these findings.
            **dict.fromkeys(
                (
                    *("USD200", "USD201", "USD202", "USD203", "USD206", "USD207"),
                    *("USD208", "USD22", "USD230", "USD231", "USD233", "USD234"),
                    *("USD235", "USD236", "USD238", "USD240", "USD241", "USD242"),
                    *("USD243", "USD245", "USD253", "USD260", "USD261", "USD264"),
                    *("USD265", "USD266"),
                ),
                _WARNING,
            ),
            "USD222": _NOTE,
            "USD227": _NOTE,
            "USD229": _NOTE,
            "RIG2": _NOTE,
            "CLIP2": _NOTE,
        },
    ),
}


def load_profile(name: str, folder: Path | None = None) -> Levels:
    """Return the severities of a built-in profile, or of a YAML or TOML file."""
    if name in PROFILES:
        return PROFILES[name].levels
    path = Path(name) if folder is None else folder / name
    if not path.is_file():
        message = f"unknown profile {name!r}, and there is no file with that name"
        hint = name_hint(name, list(PROFILES))
        raise OptionError(Fault("VAL009", message, None, (), hint))
    is_toml = path.suffix.lower() == ".toml"
    table = _read_toml(path) if is_toml else _read_document(path)
    return _parse_levels(table, str(path))


def _read_document(path: Path) -> Mapping[str, Any]:
    from animtool.documents.document import read_document

    try:
        return dict(read_document(path).value)
    except FormatError as error:
        raise OptionError(error.faults) from error


def _read_toml(path: Path) -> Mapping[str, Any]:
    """Read a TOML profile, or the severities in project settings (VAL008)."""
    try:
        table = parse_toml(read_input(path, MAX_TEXT_BYTES).decode("utf-8"))
    except FormatError as error:
        raise _profile_error(error.faults[0].message, str(path)) from error
    except ValueError as error:
        raise _profile_error(f"cannot be read: {error}", str(path)) from error
    settings = table.get("validate")
    if isinstance(settings, dict):
        return {"severity": settings.get("severity", {})}
    return table


def _parse_levels(table: Mapping[str, Any], path: str) -> Levels:
    for key in table:
        if key not in _PROFILE_KEYS:
            hint = f"allowed: {', '.join(_PROFILE_KEYS)}"
            raise _profile_error(f"unknown key {key!r}", path, hint)
    version = table.get("profile", _VERSION)
    if version != _VERSION:
        raise _profile_error(f"profile is {version!r}", path, f"write {_VERSION}")
    base_name = table.get("extends", "default")
    if not isinstance(base_name, str) or base_name not in PROFILES:
        hint = f"allowed: {', '.join(PROFILES)}"
        raise _profile_error(f"extends is {base_name!r}", path, hint)
    severities = table.get("severity", {})
    if not isinstance(severities, dict):
        message = f"severity is {severities!r}, not a table of codes"
        hint = "write codes and severities, such as USD25: note"
        raise _profile_error(message, path, hint)
    levels = {
        str(code).upper(): _parse_level(code, value, path)
        for code, value in severities.items()
    }
    _check_codes(levels, path)
    # A prefix in the file replaces all codes of the base that it covers.
    base_levels = {
        code: level
        for code, level in PROFILES[base_name].levels.items()
        if not any(code.startswith(current_codes(prefix)) for prefix in levels)
    }
    return {**base_levels, **levels}


def _parse_level(code: object, value: object, path: str) -> Severity | None:
    if value is False or value == OFF_WORD:
        return None
    if value not in list(Severity):
        hint = f"allowed: {', '.join(Severity)}, {OFF_WORD}"
        raise _profile_error(f"severity.{code} is {value!r}", path, hint)
    return Severity(str(value))


def _check_codes(levels: Levels, path: str) -> None:
    rules, _ = all_rules()
    for code in levels:
        is_known = code and any(rule.startswith(current_codes(code)) for rule in rules)
        if not is_known:
            message, hint = f"no code matches {code!r}", name_hint(code, [*rules])
            raise OptionError(Fault("VAL005", message, path, (), hint))


def _profile_error(message: str, path: str, hint: str | None = None) -> OptionError:
    return OptionError(Fault("VAL008", message, path, (), hint))
