"""Validates files: matching paths, running rules, ignoring findings."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from animtool.core.arguments import ArgumentNamer
from animtool.core.errors import (
    AnimtoolError,
    ExitCode,
    Fault,
    FormatError,
    NoMatchError,
    Severity,
    excerpt,
)
from animtool.core.files.reading import matching_files, nearest_file, unreadable_error
from animtool.core.loaded import path_list
from animtool.core.process.signals import without_interrupts
from animtool.core.process.supervisor import follow_parent, has_crashed, without_main
from animtool.core.record import dataclass
from animtool.core.rules import Rule, all_rules
from animtool.documents.ignore import IgnoreEntries
from animtool.validation.options import ValidateOptions, check_codes, settings_of
from animtool.validation.subjects.open import (
    INPUT_SUFFIXES,
    open_file,
    values_of_batches,
)
from animtool.validation.subjects.subject import CheckedFile

if TYPE_CHECKING:
    from animtool.documents.variables import SceneValues


def find_files(paths: Iterable[Path | str]) -> list[Path]:
    """Return the files that match the given paths, without duplicates, in path order.

    See `animtool.core.files.reading.matching_files`; folders are searched for all file
    names that animtool knows.
    """
    return match_files(paths)[0]


def match_files(paths: Iterable[Path | str]) -> tuple[list[Path], list[Fault]]:
    """Return the files of `find_files`, and a warning for each path without a match."""
    # An empty text is an unset shell variable; the current folder is ".".
    path_texts = [path_text for path in paths if (path_text := str(path))]
    for path_text in path_texts:
        if "\0" in path_text:
            raise unreadable_error(Path(path_text), "embedded null byte")
    files: dict[Path, None] = {}
    unmatched_warnings = []
    for path_text in path_texts:
        matching_paths = [
            file.path for file in matching_files(path_text, INPUT_SUFFIXES)
        ]
        files.update(dict.fromkeys(matching_paths))
        if not matching_paths:
            message, hint = (
                f"no file to check in {path_text!r}",
                nearest_file(Path(path_text)),
            )
            fault = Fault("VAL010", message, hint=hint, severity=Severity.WARNING)
            unmatched_warnings.append(fault)
    if not files:
        message = f"no file to check in {', '.join(path_texts)}"
        if not path_texts:
            message = "the path is empty"
            hint = "is a variable of the shell not set? the current folder is '.'"
            raise NoMatchError(Fault("VAL006", message, hint=hint))
        hint = "animtool checks .rig.yaml, .clip.yaml, .scene.yaml, .bvh and .usda; "
        hint += "animtool explain VAL006 lists all names"
        suggestion = nearest_file(Path(path_texts[0])) if path_texts else None
        hint = f"{suggestion}; {hint}" if suggestion else hint
        raise NoMatchError(Fault("VAL006", message, hint=hint))
    return list(files), unmatched_warnings


Finding = Fault

# With fewer files, a single process is faster than starting others.
MIN_FILES_PER_PROCESS = 40
# Number of files that a process takes at a time.
FILES_PER_CHUNK = 10
# Findings that another finding in the same file explains, by the codes that do.
CAUSES_BY_CODE = {
    "MKR117": {"MKR204"},
    "MOT202": {"TAKE013"},
    "MOT203": {"TAKE013"},
    "MOT205": {"TAKE013"},
    "MOT206": {"TAKE013"},
    "MOT207": {"TAKE013"},
    "MOT208": {"TAKE013"},
    "MOT209": {"CLIP122", "CLIP123", "TAKE013"},
    "MOT213": {"USD126"},
    "RIG204": {"RIG115"},
}
# Codes of these that only a cause at or below their own location explains.
LOCALLY_CAUSED_CODES = {"RIG204"}


@dataclass(frozen=True, slots=True)
class ListedFinding:
    """A finding in a report, with its state of repair."""

    fault: Fault
    fixable: bool = False  # whether `--fix` can fix it
    done: str = ""  # how it was fixed


@dataclass(frozen=True, slots=True)
class Report:
    """Result of validation: the checked files and their findings."""

    files: tuple[Path, ...]  # the validated files, in order
    findings: tuple[Fault, ...]  # findings by file, line and column
    broken_rules: tuple[Fault, ...] = ()  # plug-in rules that could not be loaded
    # Findings that `--fix` can fix, if that was checked.
    fixable: frozenset[Fault] = frozenset()
    # Findings that were fixed before, and how.
    mended: tuple[tuple[Fault, str], ...] = ()
    json_keys: ClassVar[str] = (
        "'validate' files findings=listed_findings{*fault fixable} "
        "mended=repairs{*fault done} summary"
    )

    @property
    def listed_findings(self) -> list[ListedFinding]:
        """The findings, marked if fixable."""
        return [ListedFinding(fault, fault in self.fixable) for fault in self.findings]

    @property
    def repairs(self) -> list[ListedFinding]:
        """The fixed findings, each with a description of the fix."""
        return [ListedFinding(fault, done=fix_text) for fault, fix_text in self.mended]

    @property
    def summary(self) -> dict[str, int]:
        """Number of findings by severity."""
        return {str(kind): self.count(kind) for kind in Severity}

    def with_argument_names(self, namer: ArgumentNamer) -> Report:
        """Return a copy with argument names as in an interface, such as ``--fix``."""
        return replace(
            self,
            findings=tuple(fault.with_argument_names(namer) for fault in self.findings),
            fixable=frozenset(
                fault.with_argument_names(namer) for fault in self.fixable
            ),
            mended=tuple(
                (fault.with_argument_names(namer), fix_text)
                for fault, fix_text in self.mended
            ),
        )

    def count(self, severity: Severity) -> int:
        """Return the number of findings of a severity."""
        return sum(fault.severity is severity for fault in self.findings)

    def unreadable(self) -> frozenset[str]:
        """Return the files whose bytes could not be read."""
        file_names = {str(path) for path in self.files}
        return frozenset(
            fault.path
            for fault in self.findings
            if fault.path in file_names and _is_unreadable(fault, fault.path)
        )

    def exit_code(self, *, strict: bool = False, exit_zero: bool = False) -> ExitCode:
        """Return the process exit code: strict counts warnings, exit_zero returns 0."""
        if self.unreadable():
            return ExitCode.MALFORMED
        failures = self.count(Severity.ERROR)
        failures += self.count(Severity.WARNING) if strict else 0
        return ExitCode.FINDINGS if failures and not exit_zero else ExitCode.OK


def validate(
    paths: Path | str | Iterable[Path | str], options: ValidateOptions | None = None
) -> list[Fault]:
    """Return the findings in rigs, clips, scenes, BVH and USD files.

    Args:
        paths: Files, folders, and globs in which ``**`` matches any folders.
        options: Selection and severities of codes.

    Raises:
        FormatError: A path has a null byte (IO001).
        NoMatchError: No file to check (VAL006).
        OptionError: Unknown code (VAL005), unsupported file type (IO002), or malformed
            project settings.
    """
    files = find_files(path_list(paths, "paths"))
    return list(validate_files(files, options).findings)


def validate_files(
    files: Sequence[Path], options: ValidateOptions | None = None
) -> Report:
    """Return the findings in files; see `validate`.

    The result does not depend on the number of processes.
    """
    options = (options or ValidateOptions()).with_profile_levels()
    check_codes(options)
    files = tuple(dict.fromkeys(files))
    file_of_folder = {path.parent: path for path in files}
    folder_options = {
        folder: settings_of(path) for folder, path in file_of_folder.items()
    }
    file_options = [options.merged_over(folder_options[path.parent]) for path in files]
    _, failed_rules = all_rules()
    values_by_scene = values_of_batches(files)
    file_values = [
        values_by_scene.get(path.resolve()) if values_by_scene else None
        for path in files
    ]
    faults_by_file = _findings_of_files(
        files, file_options, file_values, _process_count(options.jobs, len(files))
    )
    spelling_by_path = {path.resolve(): str(path) for path in files}
    findings = {
        _with_file_name(fault, spelling_by_path)
        for faults in faults_by_file
        for fault in faults
    }
    return Report(files, tuple(sorted(findings, key=_sort_key)), failed_rules)


def _process_count(jobs: int | None, file_count: int) -> int:
    if jobs is not None:
        return max(1, min(jobs, file_count))
    return max(1, min(os.cpu_count() or 1, file_count // MIN_FILES_PER_PROCESS))


def _findings_of_files(
    files: Sequence[Path],
    file_options: Sequence[ValidateOptions],
    file_values: Sequence[SceneValues | None],
    process_count: int,
) -> Iterator[list[Fault]]:
    faults = None
    # Which file crashed before is known only in this process.
    if process_count > 1 and not has_crashed():
        faults = _findings_in_processes(files, file_options, file_values, process_count)
    yield from (
        map(_check_file, files, file_options, file_values) if faults is None else faults
    )


def _findings_in_processes(
    files: Sequence[Path],
    file_options: Sequence[ValidateOptions],
    file_values: Sequence[SceneValues | None],
    process_count: int,
) -> list[list[Fault]] | None:
    """Validate files in several processes; return the reported findings of each file.

    Returns None if a process crashed; validating again in this process then finds the
    file that causes the crash.
    """
    from concurrent.futures import BrokenExecutor, ProcessPoolExecutor
    from multiprocessing import get_context

    # Fresh processes: forking a process with threads may deadlock.
    context = get_context("spawn")
    try:
        with ProcessPoolExecutor(process_count, context, follow_parent) as pool:
            with without_interrupts(), without_main():
                results = pool.map(
                    _check_file,
                    files,
                    file_options,
                    file_values,
                    chunksize=FILES_PER_CHUNK,
                )
            return list(results)
    except BrokenExecutor:
        return None


def _check_file(
    path: Path, options: ValidateOptions, values: SceneValues | None
) -> list[Fault]:
    """Return the selected findings of one file, with their configured severities.

    values: Values of the variables of a scene, from a batch file.
    """
    try:
        checked_file = open_file(path, values)
    except AnimtoolError as error:
        if error.exit_code is ExitCode.USAGE:
            raise
        faults = list(error.faults)
    else:
        faults = findings_in(checked_file)
        options = options.with_profile(checked_file.profile)
    return [
        options.with_severity(fault)
        for fault in faults
        if options.selects(fault.code) or _is_unreadable(fault, str(path))
    ]


def _is_unreadable(fault: Fault, path: str) -> bool:
    """Return whether a finding reports an unreadable file; no option can ignore it."""
    return fault.code == "IO001" and fault.path == path


def findings_in(checked_file: CheckedFile) -> list[Fault]:
    """Return the findings of all rules in a file, except those that it ignores."""
    faults = list(checked_file.faults)
    rules, _ = all_rules()
    for rule in rules.values():
        if rule.check and checked_file.kind in rule.kinds:
            faults += _run_rule(rule, checked_file)
    faults = [fault for fault in faults if not _is_explained(fault, faults)]
    if checked_file.document is None:
        return faults
    ignores = IgnoreEntries.from_document(checked_file.document)
    faults = ignores.hide(faults)
    # Refused parts may hide findings that an entry is meant for.
    if checked_file.subject is not None:
        faults += ignores.entry_faults()
    return faults


def _is_explained(fault: Fault, faults: Sequence[Fault]) -> bool:
    """Return whether another finding is the cause of one, by `CAUSES_BY_CODE`."""
    causes = CAUSES_BY_CODE.get(fault.code, ())
    location = (fault.where or "") if fault.code in LOCALLY_CAUSED_CODES else ""
    return any(
        other_fault.code in causes and (other_fault.where or "").startswith(location)
        for other_fault in faults
    )


def findings_of_rule(rule: Rule, path: Path) -> list[Fault]:
    """Return the findings of one rule in a file; its errors are raised."""
    checked_file = open_file(path)
    if checked_file.kind not in rule.kinds:
        kinds_text = ", ".join(sorted(rule.kinds))
        message = f"is a {checked_file.kind} file, but {rule.code} checks {kinds_text}"
        raise FormatError(Fault("DOC009", message, str(path), hint="leave it out"))
    subjects = _rule_subjects(rule, checked_file)
    if not subjects:
        raise FormatError(checked_file.faults)
    return [fault for subject in subjects for fault in _rule_findings(rule, subject)]


def _rule_subjects(rule: Rule, checked_file: CheckedFile) -> Sequence[object]:
    """Return the objects of a file that a rule checks; none if it could not be read."""
    if rule.takes:
        return checked_file.takes
    return () if checked_file.subject is None else (checked_file.subject,)


def _rule_findings(rule: Rule, subject: object) -> Iterator[Fault]:
    """Yield a rule's findings in a subject with the rule's severity, except notes."""
    for fault in rule.load()(subject):
        is_note = fault.severity is Severity.NOTE
        yield fault if is_note else replace(fault, severity=rule.severity)


def _run_rule(rule: Rule, checked_file: CheckedFile) -> list[Fault]:
    """Return the findings of a rule; a crash of the rule is reported as a finding."""
    try:
        return [
            fault
            for subject in _rule_subjects(rule, checked_file)
            for fault in _rule_findings(rule, subject)
        ]
    except Exception as error:
        document = checked_file.document
        path = None if document is None else str(document.path)
        error_type = type(error).__name__
        message = f"rule {rule.code} failed: {error_type}: {excerpt(str(error), 200)}"
        hint = "please report it to the author of the rule"
        return [Fault("VAL003", message, path, (), hint)]


def _with_file_name(fault: Fault, spelling_by_path: dict[Path, str]) -> Fault:
    """Return a finding with its path spelled as the user did, or relative."""
    if fault.path is None or fault.path in spelling_by_path.values():
        return fault
    try:
        path = Path(fault.path).resolve()
    except (OSError, ValueError):
        return fault
    working_folder = Path.cwd()
    shown_path = path
    if path.is_relative_to(working_folder):
        shown_path = path.relative_to(working_folder)
    return replace(fault, path=spelling_by_path.get(path, str(shown_path)))


def _sort_key(fault: Fault) -> tuple[object, ...]:
    return (
        fault.path or "",
        fault.lines,
        fault.column or 0,
        fault.code,
        fault.where or "",
        fault.message,
        fault.hint or "",
    )
