"""Findings that a file itself says are known and stay."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

from animtool.documents.document import Document
from animtool.documents.names import nearest
from animtool.errors import Fault, Severity
from animtool.rules import all_rules, current_codes

_STEP = re.compile(r"([^.\[\]]+)|\[([^\[\]]*)\]")
# What an entry of a list is known by.
_NAMES = ("name", "target", "joint", "effector")


@dataclass(slots=True)
class Ignores:
    """The entries of ``ignore`` in a file, and how often each hid something."""

    document: Document  # the file
    used: list[int]  # how many findings each entry hid

    @classmethod
    def of(cls, document: Document) -> Ignores:
        """Return those of a document; malformed ones are its reader's to refuse."""
        return cls(document, [0] * len(_entries(document)))

    def hide(self, faults: list[Fault]) -> list[Fault]:
        """Return the findings that no entry names."""
        return [fault for fault in faults if not self._hides(fault)]

    def remarks(self) -> Iterator[Fault]:
        """Yield what is wrong with the entries once everything was looked at."""
        rules, _ = all_rules()
        for i, entry in enumerate(_entries(self.document)):
            code = entry["code"]
            if current_codes(code)[0] not in rules:
                message = f"{code!r} is no code"
                hint = nearest(code, sorted(rules))
                yield self.document.fault(
                    "VAL002", ("ignore", i, "code"), message, hint
                )
            elif not self.used[i]:
                where = f" at {entry['where']}" if entry.get("where") else ""
                message = f"nothing here is {code}{where}"
                hint = "leave it out"
                fault = self.document.fault("VAL001", ("ignore", i), message, hint)
                yield replace(fault, severity=Severity.WARNING)

    def _hides(self, fault: Fault) -> bool:
        if fault.path != str(self.document.path):
            return False
        places = self._spellings(fault.where or "")
        hidden = False
        for i, entry in enumerate(_entries(self.document)):
            pattern = entry.get("where")
            if fault.code in current_codes(entry["code"]) and (
                not pattern or any(_covers(pattern, place) for place in places)
            ):
                self.used[i] += 1
                hidden = True
        return hidden

    def _spellings(self, where: str) -> list[str]:
        """Return a place with entries of lists by number, and by name."""
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
    found = document.value.get("ignore")
    entries = found if isinstance(found, list) else []
    return [e for e in entries if _is_map(e) and isinstance(e.get("code"), str)]


def _is_map(node: Any) -> bool:
    return isinstance(node, dict)


def _covers(pattern: str, place: str) -> bool:
    """Return whether a pattern is a place, or one around it.

    >>> _covers("joints[*_l]", "joints[knee_l].limits"), _covers("joint", "joints[2]")
    (True, False)
    """
    words = ".*".join(map(re.escape, pattern.split("*")))
    return re.fullmatch(rf"{words}(?:[.\[].*)?", place) is not None
