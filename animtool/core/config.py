"""Project settings from the nearest ``animtool.toml`` or ``[tool.animtool]``."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import field, fields, replace
from fractions import Fraction
from functools import lru_cache
from pathlib import Path
from typing import Any

from animtool.core.errors import Fault, FormatError, OptionError, excerpt
from animtool.core.files.reading import (
    MAX_TEXT_BYTES,
    exists,
    path_from_folder,
    read_input,
    record_input,
)
from animtool.core.rates import MAX_FRAME_NUMBER, parse_rate
from animtool.core.record import dataclass
from animtool.core.timecode import is_timecode

# The same depth as for YAML documents.
MAX_TOML_DEPTH = 50
# The parser's time grows with the square of the number of key parts. Matches start only
# where no part or escape precedes, so that the search takes linear time.
_KEY_PART = r"""(?:[\w-]++|"(?:[^"\\\n]|\\.)*+"|'[^'\n]*+')"""
_TOO_DEEP_KEY = re.compile(
    rf"(?<![\w\\-])(?:{_KEY_PART}[ \t]*+\.[ \t]*+){{{MAX_TOML_DEPTH}}}"
)


def parse_toml(text: str) -> dict[str, Any]:
    """Return the tables of TOML text."""
    import tomllib

    too_deep_key = _TOO_DEEP_KEY.search(text)
    if too_deep_key is not None:
        raise _depth_error(
            f" (at line {text.count(chr(10), 0, too_deep_key.start()) + 1})"
        )
    try:
        tables = tomllib.loads(text)
    except RecursionError as error:
        raise _depth_error() from error
    values: list[Any] = [tables]
    for _ in range(MAX_TOML_DEPTH):
        values = [inner for value in values for inner in _nested_values(value)]
        if not values:
            return tables
    raise _depth_error()


def _depth_error(position: str = "") -> ValueError:
    return ValueError(f"it is nested deeper than {MAX_TOML_DEPTH}{position}")


def _nested_values(value: Any) -> Iterable[Any]:
    """Return the values of a table or items of a list; empty for anything else."""
    if isinstance(value, dict):
        return value.values()
    return value if isinstance(value, list) else ()


# Folders by which version control systems mark the root of a checkout.
VERSION_CONTROL_FOLDERS = (".git", ".hg", ".svn", ".jj")


# One petabyte.
MAX_ARRAY_MB = 1_000_000_000


@dataclass(frozen=True, slots=True)
class TimelineConfig:
    """Project settings for values that timelines do not state."""

    fps: Fraction | None = None  # rate of the shots, and of the time codes of an EDL
    cut_start: int | None = None  # first frame of each cut; None begins shots at start
    first_timecode: str | None = None  # of each take, such as 01:00:00:00


@dataclass(frozen=True, slots=True)
class Config:
    """Project settings that apply to every command."""

    # Time code of the first frame, often 1001; None leaves it at 1.
    start: Fraction | None = None
    # Folders that files of the project may refer to: the folder of the settings, and
    # those they name.
    roots: tuple[Path, ...] = ()
    # Options of `animtool validate`, unparsed.
    validate: Mapping[str, Any] = field(default_factory=dict)
    # Maximum size read from one archive of arrays [MB]; None for 1000.
    max_array_mb: int | None = None
    path: Path | None = None  # the settings file; None if there is none
    timeline: TimelineConfig = TimelineConfig()


def find_config(path: Path) -> Config:
    """Return the settings of the nearest enclosing folder that has settings.

    ``animtool.toml`` is read in full, ``pyproject.toml`` at ``[tool.animtool]``.
    """
    for folder in path.resolve().parents:
        config_file, pyproject = folder / "animtool.toml", folder / "pyproject.toml"
        record_input(config_file)
        if config_file.is_file():
            return _config_from_table(config_file, _read_toml(config_file))
        record_input(pyproject)
        if pyproject.is_file():
            tools = _read_toml(pyproject).get("tool", {})
            table = tools.get("animtool") if isinstance(tools, dict) else None
            if table is not None:
                return _config_from_table(pyproject, table)
    return Config()


def _read_toml(path: Path) -> dict[str, Any]:
    try:
        return _parse_toml(read_input(path, MAX_TEXT_BYTES).decode("utf-8"))
    except FormatError as error:
        fault = replace(error.faults[0], code="CFG001")
        raise OptionError(fault) from error
    except ValueError as error:
        raise OptionError(_toml_fault(str(error), str(path))) from error


def _toml_fault(problem: str, path: str) -> Fault:
    """Return a fault for malformed TOML, from the parser's message."""
    match = re.fullmatch(r"(.*) \(at line (\d+), column (\d+)\)", problem)
    if match is None:
        problem = problem.removesuffix(" (at end of document)")
        return Fault("CFG001", f"invalid TOML: {_lower_first(problem)}", path)
    lines, column = (int(match[2]),), int(match[3])
    return Fault(
        "CFG001", f"invalid TOML: {_lower_first(match[1])}", path, lines, column=column
    )


def _lower_first(text: str) -> str:
    return text[:1].lower() + text[1:]


# Cached, since the files of a project share their settings.
_parse_toml = lru_cache(maxsize=8)(parse_toml)


def _config_from_table(path: Path, table: Any) -> Config:
    if not isinstance(table, dict):
        message = f"animtool is {table!r}, not a table of settings"
        raise OptionError(Fault("CFG001", message, str(path)))
    names = [setting.name for setting in fields(Config) if setting.name != "path"]
    for name in table:
        if name not in names:
            message, allowed = f"unknown setting {name!r}", ", ".join(names)
            hint = f"allowed: {allowed}"
            raise OptionError(Fault("CFG002", message, str(path), (), hint))
    start = table.get("start")
    if start is not None and not (
        _is_integer(start) and abs(start) <= MAX_FRAME_NUMBER
    ):
        message = f"start is {excerpt(str(start))}, not a whole number from "
        raise _value_error(path, f"{message}{-MAX_FRAME_NUMBER} to {MAX_FRAME_NUMBER}")
    roots = table.get("roots", [])
    if not isinstance(roots, list) or not all(isinstance(root, str) for root in roots):
        message = f"roots is {excerpt(str(roots))}, not a list of folders"
        roots_hint = f'write roots = ["{roots}"]' if isinstance(roots, str) else None
        raise _value_error(path, message, roots_hint)
    folders = (path.parent, *(path.parent / root for root in roots))
    validate = table.get("validate", {})
    if not isinstance(validate, dict):
        raise _value_error(path, f"validate is {validate!r}, not a table of settings")
    max_mb = table.get("max_array_mb")
    if max_mb is not None and not (_is_integer(max_mb) and 0 < max_mb <= MAX_ARRAY_MB):
        message = f"max_array_mb is {max_mb!r}, not a whole number from 1 to "
        raise _value_error(path, f"{message}{MAX_ARRAY_MB}")
    start_frame = None if start is None else Fraction(start)
    timeline = _timeline_from_table(path, table.get("timeline", {}))
    return Config(start_frame, folders, validate, max_mb, path, timeline)


def _is_integer(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


def _value_error(path: Path, message: str, hint: str | None = None) -> OptionError:
    """Return the error for a setting with an invalid value (CFG003)."""
    return OptionError(Fault("CFG003", message, str(path), hint=hint))


def _timeline_from_table(path: Path, table: Any) -> TimelineConfig:
    """Parse the table ``timeline`` of project settings (invalid: CFG002, CFG003)."""
    if not isinstance(table, dict):
        message = f"timeline is {excerpt(str(table))}, not a table of settings"
        raise _value_error(path, message)
    names = [setting.name for setting in fields(TimelineConfig)]
    values: dict[str, Any] = {}
    for name, value in table.items():
        if name not in names:
            message = f"unknown setting timeline.{name}"
            hint = f"allowed: {', '.join(names)}"
            raise OptionError(Fault("CFG002", message, str(path), (), hint))
        message = f"timeline.{name} is {excerpt(str(value))}, not a "
        is_frame = _is_integer(value) and abs(value) <= MAX_FRAME_NUMBER
        if name == "fps":
            try:
                values[name] = parse_rate(value)
            except ValueError as error:
                raise _value_error(path, f"timeline.fps: {error}") from error
        elif name == "cut_start" and not is_frame:
            message += f"whole number from {-MAX_FRAME_NUMBER} to {MAX_FRAME_NUMBER}"
            raise _value_error(path, message)
        elif name == "first_timecode" and not is_timecode(value):
            raise _value_error(path, f"{message}time code such as '01:00:00:00'")
        values.setdefault(name, value)
    return TimelineConfig(**values)


def project_roots(path: Path) -> tuple[Path, ...]:
    """Return the folders whose files a file may refer to.

    The folders are those of the project's settings; if it has none, the nearest
    parent folder under version control, else the folder of the file.
    """
    folder = path.resolve().parent
    return find_config(path).roots or (_version_control_root(folder) or folder,)


def _version_control_root(folder: Path) -> Path | None:
    """Return the nearest folder under version control; None if there is none.

    A home folder or file system root under version control is no project, since its
    files come from anywhere.
    """
    for folder_above in (folder, *folder.parents):
        if not may_be_project(folder_above):
            return None
        if any((folder_above / name).exists() for name in VERSION_CONTROL_FOLDERS):
            return folder_above
    return None


def outside_hint(path: Path, name: str, *, is_output: bool = False) -> str:
    """Return how to allow a file outside the project that another file refers to.

    Args:
        path: The file that has the reference.
        name: The reference, relative to the folder of the file.
        is_output: The referenced file is an output and need not exist.
    """
    folder = path.resolve().parent
    try:
        target_path = (folder / name).resolve()
    except (OSError, RuntimeError, ValueError):
        return "use a file inside the project"
    if not (is_output or exists(target_path)):
        return (
            f"nor does it exist: copy {target_path.name}, and the files it refers to, "
            f"into {folder}, and write its name here"
        )
    settings_path = find_config(path).path
    if settings_path is None:
        project_folder = _innermost_project(folder, target_path)
        if project_folder is not None:
            hint = f"to use files of all {project_folder}, create an empty file "
            return f"{hint}animtool.toml in it"
        settings_path = folder / "animtool.toml"
    root = path_from_folder(target_path.parent, settings_path.parent)
    is_pyproject = settings_path.name == "pyproject.toml"
    table_text = " under [tool.animtool]" if is_pyproject else ""
    return (
        f'to allow that folder, add roots = ["{root}"] to {settings_path}{table_text}'
    )


def _innermost_project(folder: Path, target: Path) -> Path | None:
    """Return the innermost project that contains both paths; None if there is none."""
    for folder_above in (folder, *folder.parents):
        if target.is_relative_to(folder_above):
            return folder_above if may_be_project(folder_above) else None
    return None


def may_be_project(folder: Path) -> bool:
    """Return whether a folder is neither a home folder nor that of a file system."""
    return folder not in {Path(folder.anchor), _home_folder()}


def _home_folder() -> Path | None:
    try:
        return Path.home().resolve()
    except (OSError, RuntimeError):
        return None
