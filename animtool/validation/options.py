"""Options of validation: selected codes, severities, and reports."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import MISSING, field, replace
from pathlib import Path
from typing import Any

from animtool.core.arguments import argument
from animtool.core.config import find_config
from animtool.core.errors import Fault, OptionError, Severity
from animtool.core.names import name_hint
from animtool.core.options import (
    convert_option_values,
    inherits_docs,
    option,
    options_of,
)
from animtool.core.record import dataclass
from animtool.core.rules import all_rules, builtin_rules, corrected_code, current_codes
from animtool.validation.profiles import PROFILES, load_profile


@inherits_docs
@dataclass(frozen=True, slots=True)
class ValidateOptions:
    """Selection and severities of codes, which may be prefixes: ``RIG``, ``RIG2``.

    Attributes:
        levels: Severities of the profile, with the lowest precedence; None disables a
            code.
    """

    select: tuple[str, ...] = option(
        (),
        "codes",
        help="Check only these codes; a prefix such as RIG2 selects all codes that "
        "start with it.",
    )
    ignore: tuple[str, ...] = option(
        (),
        "codes",
        help="Skip these codes. If both options match a code, the longer prefix wins.",
    )
    severity: Mapping[str, Severity] = option(
        MISSING,
        "severities",
        default_factory=dict,
        help="Report a code as an error, a warning or a note.",
    )
    jobs: int | None = option(
        1,
        "processes",
        short_flag="-j",
        help="Number of processes.  [default: automatic]",
    )
    profile: str = option(
        "",
        "text",
        metavar="NAME|FILE",
        help="Severities for a delivery: asset, layer, shot, vendor, default, or your "
        "own file.  [default: layer for a USD layer without its rig, else default]",
    )
    levels: Mapping[str, Severity | None] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Convert a single code to a list; check the number of processes."""
        convert_option_values(self)

    def selects(self, code: str) -> bool:
        """Return whether a code is selected, and not ignored or off in the profile.

        >>> ValidateOptions(select=("RIG",), ignore=("RIG2",)).selects("RIG201")
        False
        """
        selected_length = _prefix_length(code, self.select) if self.select else 0
        if selected_length < 0 or selected_length <= _prefix_length(code, self.ignore):
            return False
        profile_prefix = _longest_prefix(code, self.levels)
        if profile_prefix is None or self.levels[profile_prefix] is not None:
            return True
        # A more specific selection overrides the profile.
        explicit_length = max(selected_length, _prefix_length(code, self.severity))
        return explicit_length >= _prefix_length_of(profile_prefix)

    def with_severity(self, fault: Fault) -> Fault:
        """Return a finding with its severity by the options, or else by the profile."""
        longest_prefix = _longest_prefix(fault.code, self.severity)
        if longest_prefix is not None:
            return replace(fault, severity=self.severity[longest_prefix])
        longest_prefix = _longest_prefix(fault.code, self.levels)
        level = None if longest_prefix is None else self.levels[longest_prefix]
        return fault if level is None else replace(fault, severity=level)

    def with_profile_levels(self) -> ValidateOptions:
        """Return these options with the levels of the named profile.

        Raises:
            OptionError: The profile is missing or malformed (VAL005, VAL008, VAL009).
        """
        if not self.profile or self.levels:
            return self
        return replace(self, levels=load_profile(self.profile))

    def with_profile(self, profile: str | None) -> ValidateOptions:
        """Return these options with the levels of a file's own profile, if any.

        A profile that is chosen by name takes precedence.
        """
        if self.profile or profile is None:
            return self
        return replace(self, levels=PROFILES[profile].levels)

    def merged_over(self, project: ValidateOptions) -> ValidateOptions:
        """Return these options merged with a project's; these take precedence."""
        return replace(
            self,
            select=self.select or project.select,
            ignore=(*project.ignore, *self.ignore),
            severity={**project.severity, **self.severity},
            profile=self.profile or project.profile,
            levels=self.levels if self.profile else project.levels,
        )


FORMATS = ("text", "json", "github", "sarif", "junit")
_NEEDS_FIX_MESSAGE = f"needs {argument('fix', True)}, which writes"
_NO_REPORT_MESSAGE = (
    f"{argument('diff')} writes a diff, not a report: remove {argument('format')}"
)


@inherits_docs
@dataclass(frozen=True, slots=True)
class ReportOptions:
    """How to fix and print findings and which exit code they give."""

    strict: bool = option(False, "switch", help="Exit with 1 if there are warnings.")
    exit_zero: bool = option(False, "switch", help="Exit with 0 whatever is found.")
    fix: bool = option(
        False,
        "switch",
        help="Repair findings with a safe fix in place, in rigs, clips, scenes and "
        "targets, and report the rest. A USD file needs -o or "
        f"{argument('overwrite', True)}; BVH is not written.",
    )
    output: Path | None = option(
        None,
        "output",
        short_flag="-o",
        required_option="fix",
        missing_message=f"{argument('output')} {_NEEDS_FIX_MESSAGE}",
        help=f"With {argument('fix', True)} and one USD file: write the repaired "
        "copy here.",
    )
    overwrite: bool = option(
        False,
        "switch",
        required_option="fix",
        missing_message=f"{argument('overwrite', True)} {_NEEDS_FIX_MESSAGE}",
        help=f"With {argument('fix', True)}: replace the file of -o; without -o, the "
        "USD files themselves.",
    )
    diff: bool = option(
        False,
        "switch",
        excludes={
            "output": f"{argument('output')} {_NEEDS_FIX_MESSAGE}",
            "overwrite": f"{argument('overwrite', True)} {_NEEDS_FIX_MESSAGE}",
            "report_format": _NO_REPORT_MESSAGE,
            "output_file": _NO_REPORT_MESSAGE,
        },
        help=f"Show what {argument('fix', True)} would change, and write nothing.",
    )
    report_format: str = option(
        "text",
        "choice",
        flag="format",
        choices=FORMATS,
        help="text, JSON, GitHub annotations, SARIF 2.1.0 or JUnit XML.",
    )
    output_file: Path | None = option(
        None, "output", help="Write the report here, and its summary to stderr."
    )


def _longest_prefix(code: str, prefixes: Iterable[str]) -> str | None:
    """Return the longest matching prefix of a code, in current or old spelling."""
    matches = [
        prefix for prefix in prefixes if code.startswith(current_codes(prefix.upper()))
    ]
    return max(matches, key=_prefix_length_of, default=None)


def _prefix_length_of(prefix: str) -> int:
    """Return the length of a prefix in its current spelling."""
    return len(current_codes(prefix.upper())[0])


def _prefix_length(code: str, prefixes: Iterable[str]) -> int:
    """Return the length of the longest prefix that matches a code, or -1."""
    longest_prefix = _longest_prefix(code, prefixes)
    return -1 if longest_prefix is None else _prefix_length_of(longest_prefix)


def check_codes(options: ValidateOptions, path: str | None = None) -> None:
    """Raise OptionError if a prefix matches no code (VAL005)."""
    faults = []
    for name in ("select", "ignore", "severity"):
        where = name if path is None else f"validate.{name}"
        for prefix in getattr(options, name):
            if not matches_code(prefix):
                message = f"no code matches {prefix!r}"
                hint = _code_hint(prefix)
                faults.append(Fault("VAL005", message, path, (), hint, where=where))
    if faults:
        raise OptionError(faults)


def matches_code(prefix: str) -> bool:
    """Return whether a text is a code or a prefix of one, in any case.

    >>> matches_code("CLIP2"), matches_code("samples")
    (True, False)
    """
    prefix = prefix.upper()
    current_prefixes = current_codes(prefix)
    if prefix and any(code.startswith(current_prefixes) for code in builtin_rules()):
        return True
    rules, _ = all_rules()
    return bool(prefix) and any(code.startswith(prefix) for code in rules)


def _code_hint(prefix: str) -> str:
    """Return a hint for a prefix that matches no code."""
    if "/" in prefix or "\\" in prefix or "." in prefix:
        return "it looks like a path; a code is such as CLIP2 or CLIP201"
    rules, _ = all_rules()
    corrected_prefix = corrected_code(prefix, rules)
    if corrected_prefix is not None:
        return f"did you mean {corrected_prefix!r}, with digits?"
    prefix_letters = re.match("[A-Z]+", prefix.upper())
    if prefix_letters and any(code.startswith(prefix_letters[0]) for code in rules):
        return f"animtool explain {prefix_letters[0]} lists them"
    hint = name_hint(prefix, list(rules))
    return "animtool explain lists them" if hint.startswith("allowed") else hint


# Settings that a project may have, in the order of their faults.
_PROJECT_SETTINGS = tuple(n for n in options_of(ValidateOptions) if n != "jobs")


def settings_of(path: Path) -> ValidateOptions:
    """Return the options in the ``validate`` table of a file's project settings."""
    config = find_config(path)
    return _parse_options(config.validate, str(config.path))


def _parse_options(table: Any, path: str) -> ValidateOptions:
    for name in table:
        if name not in _PROJECT_SETTINGS:
            message = f"unknown setting validate.{name}"
            hint = f"allowed: {', '.join(_PROJECT_SETTINGS)}"
            raise OptionError(Fault("CFG002", message, path, (), hint))

    def value_error(name: str, text: str, hint: str | None = None) -> OptionError:
        message = f"validate.{name} is {text}"
        return OptionError(Fault("CFG003", message, path, (), hint))

    select, ignore = table.get("select", []), table.get("ignore", [])
    for name, codes in (("select", select), ("ignore", ignore)):
        is_list = isinstance(codes, list)
        if not is_list or not all(isinstance(code, str) for code in codes):
            raise value_error(name, f"{codes!r}, not a list of codes")
    severities = table.get("severity", {})
    if not isinstance(severities, dict):
        raise value_error("severity", f"{severities!r}, not a table of codes")
    for code, level in severities.items():
        if level not in list(Severity):
            hint = f"allowed: {', '.join(Severity)}"
            raise value_error(f"severity.{code}", repr(level), hint)
    severities = {code: Severity(level) for code, level in severities.items()}
    profile = table.get("profile", "")
    if not isinstance(profile, str):
        raise value_error("profile", f"{profile!r}, not a name or a file")
    profile_levels = load_profile(profile, Path(path).parent) if profile else {}
    options = ValidateOptions(
        tuple(select), tuple(ignore), severities, profile=profile, levels=profile_levels
    )
    check_codes(options, path)
    return options
