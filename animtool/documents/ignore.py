"""Findings of a file that its ``ignore`` entries accept."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from animtool.core.errors import AnimtoolError, Fault, Severity
from animtool.core.names import DOCUMENT_FILE_SUFFIXES, name_hint
from animtool.core.record import dataclass

if TYPE_CHECKING:
    from animtool.documents.document import Document

_STEP_PATTERN = re.compile(r"([^.\[\]]+)|\[([^\[\]]*)\]")
# Keys that identify an entry of a list.
_NAME_KEYS = ("name", "target", "joint", "effector")


@dataclass(slots=True)
class IgnoreEntries:
    """The ``ignore`` entries of a file, and the number of matches of each."""

    document: Document  # the file
    match_counts: list[int]  # number of findings hidden by each entry

    @classmethod
    def from_document(cls, document: Document) -> IgnoreEntries:
        """Return the entries of a document; its reader refuses malformed ones."""
        return cls(document, [0] * len(_ignore_entries(document)))

    def hide(self, faults: list[Fault]) -> list[Fault]:
        """Return the findings that no entry matches; count the matches of entries."""
        return [fault for fault in faults if not self._match_entries(fault)]

    def entry_faults(self) -> Iterator[Fault]:
        """Yield faults in the entries; call this after all findings were matched."""
        from animtool.core.rules import all_rules, current_codes

        rules, _ = all_rules()
        for i, entry in enumerate(_ignore_entries(self.document)):
            code = entry["code"]
            if current_codes(code)[0] not in rules:
                message = f"unknown code {code!r}"
                hint = name_hint(code, sorted(rules))
                location = ("ignore", i, "code")
                yield self.document.fault("VAL002", location, message, hint)
            elif not self.match_counts[i]:
                location_text = f" at {entry['where']}" if entry.get("where") else ""
                message = f"nothing here has {code}{location_text}"
                hint = "remove it"
                fault = self.document.fault("VAL001", ("ignore", i), message, hint)
                yield replace(fault, severity=Severity.WARNING)

    def _match_entries(self, fault: Fault) -> bool:
        """Return whether any entry matches a finding; count every match."""
        from animtool.core.rules import current_codes

        if fault.path != str(self.document.path):
            return False
        locations = self._location_variants(fault.where or "")
        is_hidden = False
        for i, entry in enumerate(_ignore_entries(self.document)):
            if fault.code not in current_codes(entry["code"]):
                continue
            pattern = entry.get("where")
            if not pattern or any(
                _matches_location(pattern, location) for location in locations
            ):
                self.match_counts[i] += 1
                is_hidden = True
        return is_hidden

    def _location_variants(self, where: str) -> list[str]:
        """Return a location in two forms: list entries by number, and by name."""
        node: Any = self.document.value
        text = ""
        for key, index in _STEP_PATTERN.findall(where):
            if index.isdigit() and isinstance(node, list) and int(index) < len(node):
                node = node[int(index)]
                name_keys = _NAME_KEYS if isinstance(node, dict) else ()
                entry_names = [
                    node[name_key] for name_key in name_keys if name_key in node
                ]
                text += f"[{entry_names[0] if entry_names else index}]"
            else:
                text += f".{key}" if key else f"[{index}]"
                node = node.get(key) if isinstance(node, dict) else None
        return [where, text.removeprefix(".")]


def _ignore_entries(document: Document) -> list[dict[str, Any]]:
    value = document.value.get("ignore")
    return [
        entry
        for entry in (value if isinstance(value, list) else ())
        if isinstance(entry, dict) and isinstance(entry.get("code"), str)
    ]


def _matches_location(pattern: str, location: str) -> bool:
    """Return whether a pattern equals a location, or contains it.

    >>> location = "joints[knee_l].limits"
    >>> _matches_location("joints[*_l]", location), _matches_location("joint", location)
    (True, False)
    """
    pattern_regex = ".*".join(map(re.escape, pattern.split("*")))
    return re.fullmatch(rf"{pattern_regex}(?:[.\[].*)?", location) is not None


def without_accepted(notices: Sequence[Fault]) -> list[Fault]:
    """Return notices without the warnings that their files accept.

    Notes report results, so they stay.
    """
    warnings = [notice for notice in notices if notice.severity is Severity.WARNING]
    accepted_warnings: set[Fault] = set()
    for path in dict.fromkeys(warning.path for warning in warnings):
        entries = _read_ignore_entries(path)
        if entries is not None:
            accepted_warnings.update(set(warnings).difference(entries.hide(warnings)))
    return [notice for notice in notices if notice not in accepted_warnings]


def _read_ignore_entries(path: str | None) -> IgnoreEntries | None:
    """Return the ``ignore`` entries of a YAML or JSON file; None if it has none."""
    if path is None or not path.endswith(DOCUMENT_FILE_SUFFIXES):
        return None
    # Only files with warnings are read again.
    from animtool.documents.document import parse_document, read_text

    try:
        text = read_text(Path(path))
        document = parse_document(text, Path(path)) if "ignore" in text else None
    except AnimtoolError:
        return None
    return IgnoreEntries.from_document(document) if document else None
