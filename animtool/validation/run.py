"""Validates files: matching paths, running rules, ignoring findings."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from animtool.core.arguments import Calling
from animtool.core.errors import (
    AnimtoolError,
    ExitCode,
    Fault,
    FormatError,
    NoMatchError,
    Severity,
    excerpt,
)
from animtool.core.files.reading import matching_files, nearest_file, unreadable
from animtool.core.names import nearest
from animtool.core.process.signals import without_interrupts
from animtool.core.process.supervisor import follow_parent, has_crashed, without_main
from animtool.core.record import dataclass
from animtool.core.rules import Rule, all_rules, current_codes
from animtool.documents.document import Document
from animtool.validation.options import ValidateOptions, check_codes, settings_of
from animtool.validation.subjects.open import SUFFIXES, open_file, values_of_batches
from animtool.validation.subjects.subject import CheckedFile

if TYPE_CHECKING:
    from animtool.documents.variables import SceneValues


def find_files(paths: Iterable[Path | str]) -> list[Path]:
    """Return the files that paths match, each once, in path order.

    See `animtool.core.files.reading.files_meant`; folders are searched for all files
    that animtool knows by name.
    """
    return match_files(paths)[0]


def match_files(paths: Iterable[Path | str]) -> tuple[list[Path], list[Fault]]:
    """Return the files of `find_files`, and a warning for each path without any."""
    # Of a variable of a shell that is not set; the folder that it is run in is ".".
    texts = [text for path in paths if (text := str(path))]
    for text in texts:
        if "\0" in text:
            raise unreadable(Path(text), "embedded null byte")
    files: dict[Path, None] = {}
    unmatched = []
    for text in texts:
        meant = [file.path for file in matching_files(text, SUFFIXES)]
        files.update(dict.fromkeys(meant))
        if not meant:
            message, hint = f"no file to check in {text!r}", nearest_file(Path(text))
            fault = Fault("VAL010", message, hint=hint, severity=Severity.WARNING)
            unmatched.append(fault)
    if not files:
        shown = ", ".join(texts) or "nothing"
        message = f"no file to check in {shown}"
        hint = f"folders are searched for {', '.join(SUFFIXES)}"
        raise NoMatchError(Fault("VAL006", message, hint=hint))
    return list(files), unmatched


_STEP = re.compile(r"([^.\[\]]+)|\[([^\[\]]*)\]")
# What an entry of a list is known by.
_NAMES = ("name", "target", "joint", "effector")


@dataclass(slots=True)
class Ignores:
    """The ``ignore`` entries of a file, and how often each matched."""

    document: Document  # the file
    used: list[int]  # how many findings each entry hid

    @classmethod
    def of(cls, document: Document) -> Ignores:
        """Return the entries of a document; its reader refuses malformed ones."""
        return cls(document, [0] * len(_entries(document)))

    def hide(self, faults: list[Fault]) -> list[Fault]:
        """Return the findings that no entry matches."""
        return [fault for fault in faults if not self._hides(fault)]

    def remarks(self) -> Iterator[Fault]:
        """Yield faults of the entries after all findings were matched."""
        rules, _ = all_rules()
        for i, entry in enumerate(_entries(self.document)):
            code = entry["code"]
            if current_codes(code)[0] not in rules:
                message = f"unknown code {code!r}"
                hint = nearest(code, sorted(rules))
                yield self.document.fault(
                    "VAL002", ("ignore", i, "code"), message, hint
                )
            elif not self.used[i]:
                where = f" at {entry['where']}" if entry.get("where") else ""
                message = f"nothing here has {code}{where}"
                hint = "remove it"
                fault = self.document.fault("VAL001", ("ignore", i), message, hint)
                yield replace(fault, severity=Severity.WARNING)

    def _hides(self, fault: Fault) -> bool:
        if fault.path != str(self.document.path):
            return False
        spellings = self._spellings(fault.where or "")
        hidden = False
        for i, entry in enumerate(_entries(self.document)):
            pattern = entry.get("where")
            if fault.code in current_codes(entry["code"]) and (
                not pattern or any(_covers(pattern, spelling) for spelling in spellings)
            ):
                self.used[i] += 1
                hidden = True
        return hidden

    def _spellings(self, where: str) -> list[str]:
        """Return a location with list entries by number, and by name."""
        node: Any = self.document.value
        text = ""
        for key, index in _STEP.findall(where):
            if index.isdigit() and isinstance(node, list) and int(index) < len(node):
                node = node[int(index)]
                names = [node[n] for n in _NAMES if n in node] if _is_map(node) else []
                text += f"[{names[0] if names else index}]"
            else:
                text += f".{key}" if key else f"[{index}]"
                node = node.get(key) if _is_map(node) else None
        return [where, text.removeprefix(".")]


def _entries(document: Document) -> list[dict[str, Any]]:
    listed = document.value.get("ignore")
    entries = listed if isinstance(listed, list) else []
    return [e for e in entries if _is_map(e) and isinstance(e.get("code"), str)]


def _is_map(node: Any) -> bool:
    return isinstance(node, dict)


def _covers(pattern: str, location: str) -> bool:
    """Return whether a pattern equals a location, or contains it.

    >>> _covers("joints[*_l]", "joints[knee_l].limits"), _covers("joint", "joints[2]")
    (True, False)
    """
    words = ".*".join(map(re.escape, pattern.split("*")))
    return re.fullmatch(rf"{words}(?:[.\[].*)?", location) is not None


Finding = Fault

# Fewer files are done before another process has started.
MIN_EACH = 40
# Files that a process takes at a time.
CHUNK = 10


@dataclass(frozen=True, slots=True)
class Entry:
    """A finding as listed in reports."""

    fault: Fault
    fixable: bool = False  # whether `--fix` can mend it
    done: str = ""  # how it was mended


@dataclass(frozen=True, slots=True)
class Report:
    """Result of validation."""

    files: tuple[Path, ...]  # that were looked at, in order
    findings: tuple[Fault, ...]  # by file, line and column
    broken: tuple[Fault, ...] = ()  # plug-in rules that could not be loaded
    # Findings that `--fix` can mend, where that was looked for.
    fixable: frozenset[Fault] = frozenset()
    # Findings that were mended before, and what was done.
    mended: tuple[tuple[Fault, str], ...] = ()
    json_keys: ClassVar[str] = (
        "'validate' files findings=entries{*fault fixable} "
        "mended=repairs{*fault done} summary"
    )

    @property
    def entries(self) -> list[Entry]:
        """The findings, marked if fixable."""
        return [Entry(fault, fault in self.fixable) for fault in self.findings]

    @property
    def repairs(self) -> list[Entry]:
        """Fixed findings, and how."""
        return [Entry(fault, done=done) for fault, done in self.mended]

    @property
    def summary(self) -> dict[str, int]:
        """Number of findings by severity."""
        return {str(kind): self.count(kind) for kind in Severity}

    def worded(self, calling: Calling) -> Report:
        """Return the report with arguments spelled for an interface."""
        return replace(
            self,
            findings=tuple(fault.worded(calling) for fault in self.findings),
            fixable=frozenset(fault.worded(calling) for fault in self.fixable),
            mended=tuple((fault.worded(calling), done) for fault, done in self.mended),
        )

    def count(self, severity: Severity) -> int:
        """Return the number of findings of a severity."""
        return sum(fault.severity is severity for fault in self.findings)

    def unreadable(self) -> frozenset[str]:
        """Return the files whose bytes could not be read."""
        named = {str(path) for path in self.files}
        return frozenset(
            fault.path
            for fault in self.findings
            if fault.path in named and _unreadable(fault, fault.path)
        )

    def exit_code(self, *, strict: bool = False, exit_zero: bool = False) -> ExitCode:
        """Return the process exit code: strict counts warnings, exit_zero gives 0."""
        if self.unreadable():
            return ExitCode.MALFORMED
        wrong = self.count(Severity.ERROR)
        wrong += self.count(Severity.WARNING) if strict else 0
        return ExitCode.FINDINGS if wrong and not exit_zero else ExitCode.OK


def validate(
    paths: Path | str | Iterable[Path | str], options: ValidateOptions | None = None
) -> list[Fault]:
    """Return the findings in rigs, clips, scenes, BVH and USD files.

    Args:
        paths: Files, folders, and globs in which ``**`` is any folders.
        options: Which codes count, and how much.

    Raises:
        FormatError: A path has a null byte (IO001).
        NothingFoundError: No file to check (VAL006).
        OptionError: A code that there is none of (VAL005), a file of a kind that is
            not checked (IO002), or settings of a project that are malformed.
    """
    requested = [paths] if isinstance(paths, Path | str) else list(paths)
    return list(validate_files(find_files(requested), options).findings)


def validate_files(
    files: Sequence[Path], options: ValidateOptions | None = None
) -> Report:
    """Return the findings in files; see `validate`.

    The same whatever the number of processes.
    """
    options = (options or ValidateOptions()).resolved()
    check_codes(options)
    files = tuple(dict.fromkeys(files))
    folders = {path.parent: path for path in files}
    projects = {folder: settings_of(path) for folder, path in folders.items()}
    settings = [options.within(projects[path.parent]) for path in files]
    _, broken = all_rules()
    by_scene = values_of_batches(files)
    values = (
        [by_scene.get(path.resolve()) for path in files]
        if by_scene
        else [None] * len(files)
    )
    by_file = _all(files, settings, values, _processes(options.jobs, len(files)))
    names = {path.resolve(): str(path) for path in files}
    findings = {_named(fault, names) for faults in by_file for fault in faults}
    return Report(files, tuple(sorted(findings, key=_order)), broken)


def _processes(jobs: int | None, files: int) -> int:
    if jobs is not None:
        return max(1, min(jobs, files))
    return max(1, min(os.cpu_count() or 1, files // MIN_EACH))


def _all(
    files: Sequence[Path],
    settings: Sequence[ValidateOptions],
    values: Sequence[SceneValues | None],
    processes: int,
) -> Iterator[list[Fault]]:
    faults = None
    # What crashed before is known in this process alone.
    if processes > 1 and not has_crashed():
        faults = _shared(files, settings, values, processes)
    yield from map(_check, files, settings, values) if faults is None else faults


def _shared(
    files: Sequence[Path],
    settings: Sequence[ValidateOptions],
    values: Sequence[SceneValues | None],
    processes: int,
) -> list[list[Fault]] | None:
    """Return the reported findings of each file, from several processes.

    None where one of them ended: done again here, it is known over which file.
    """
    from concurrent.futures import BrokenExecutor, ProcessPoolExecutor
    from multiprocessing import get_context

    # Fresh processes: a fork of one with threads may stop for ever.
    context = get_context("spawn")
    try:
        with ProcessPoolExecutor(processes, context, follow_parent) as pool:
            with without_interrupts(), without_main():
                results = pool.map(_check, files, settings, values, chunksize=CHUNK)
            return list(results)
    except BrokenExecutor:
        return None


def _check(
    path: Path, options: ValidateOptions, values: SceneValues | None
) -> list[Fault]:
    """Return the reported findings of one file, with values of scene variables."""
    try:
        checked = open_file(path, values)
    except AnimtoolError as error:
        if error.exit_code is ExitCode.USAGE:
            raise
        faults = list(error.faults)
    else:
        faults = findings_in(checked)
        options = options.with_profile(checked.profile)
    return [
        options.of(fault)
        for fault in faults
        if options.counts(fault.code) or _unreadable(fault, str(path))
    ]


def _unreadable(fault: Fault, path: str) -> bool:
    """Return whether a finding is an unreadable file, which always counts."""
    return fault.code == "IO001" and fault.path == path


def findings_in(checked: CheckedFile) -> list[Fault]:
    """Return all findings in a checked file, whatever counts."""
    faults = list(checked.faults)
    rules, _ = all_rules()
    for rule in rules.values():
        if rule.check and checked.kind in rule.kinds:
            faults += _run(rule, checked)
    if checked.document is None:
        return faults
    ignores = Ignores.of(checked.document)
    faults = ignores.hide(faults)
    # What the reader refused hides findings that an entry may be for.
    return [*faults, *(ignores.remarks() if checked.subject is not None else ())]


def findings_of_rule(rule: Rule, path: Path) -> list[Fault]:
    """Return the findings of one rule in a file; its errors are raised."""
    checked = open_file(path)
    if checked.kind not in rule.kinds:
        kinds = ", ".join(sorted(rule.kinds))
        message = f"is a {checked.kind} file, but {rule.code} checks {kinds}"
        raise FormatError(Fault("DOC009", message, str(path)))
    subjects = _subjects(rule, checked)
    if not subjects:
        raise FormatError(checked.faults)
    return [fault for subject in subjects for fault in _faults_of(rule, subject)]


def _subjects(rule: Rule, checked: CheckedFile) -> Sequence[object]:
    """Return a rule's subjects in a file; none if its reader refused it."""
    if rule.takes:
        return checked.takes
    return () if checked.subject is None else (checked.subject,)


def _faults_of(rule: Rule, subject: object) -> Iterator[Fault]:
    """Yield the findings of a rule; notes stay notes."""
    for fault in rule.load()(subject):
        is_note = fault.severity is Severity.NOTE
        yield fault if is_note else replace(fault, severity=rule.severity)


def _run(rule: Rule, checked: CheckedFile) -> list[Fault]:
    """Return the findings of a rule; a crash is a finding, too."""
    try:
        return [f for s in _subjects(rule, checked) for f in _faults_of(rule, s)]
    except Exception as error:
        path = None if checked.document is None else str(checked.document.path)
        kind = type(error).__name__
        message = f"rule {rule.code} failed: {kind}: {excerpt(str(error), 200)}"
        hint = "please report it to the author of the rule"
        return [Fault("VAL003", message, path, (), hint)]


def _named(fault: Fault, names: dict[Path, str]) -> Fault:
    """Return a finding with its file spelled as the user did, or relative."""
    if fault.path is None or fault.path in names.values():
        return fault
    try:
        path = Path(fault.path).resolve()
    except (OSError, ValueError):
        return fault
    here = Path.cwd()
    shown = path.relative_to(here) if path.is_relative_to(here) else path
    return replace(fault, path=names.get(path, str(shown)))


def _order(fault: Fault) -> tuple[object, ...]:
    return (
        fault.path or "",
        fault.lines,
        fault.column or 0,
        fault.code,
        fault.where or "",
        fault.message,
        fault.hint or "",
    )
