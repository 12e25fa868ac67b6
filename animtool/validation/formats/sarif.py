"""Reports as SARIF 2.1.0, for code hosts and editors.

References:
    OASIS, "Static Analysis Results Interchange Format (SARIF) Version 2.1.0", 2020.
"""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import PurePath
from typing import Any
from urllib.parse import quote

from animtool.core.errors import Fault
from animtool.core.quantities import printable_json
from animtool.core.rules import Rule, all_rules, page_text
from animtool.core.source_lines import SourceLineCache
from animtool.validation.run import Report

SCHEMA = "https://json.schemastore.org/sarif-2.1.0.json"
MAX_SNIPPET_LENGTH = 1000


def sarif_report(report: Report) -> str:
    """Return a SARIF log with one run: the violated rules, their pages, and results."""
    codes = sorted({fault.code for fault in report.findings})
    rules, _ = all_rules()
    sources = SourceLineCache()
    rule_objects = [_rule_object(rules[code]) for code in codes if code in rules]
    driver = {"name": "animtool", "version": version("animtool"), "rules": rule_objects}
    index_by_code = {rule["id"]: i for i, rule in enumerate(rule_objects)}
    results = [
        _result_object(fault, index_by_code, sources) for fault in report.findings
    ]
    _number_duplicates(results)
    file_names = dict.fromkeys(map(str, report.files))
    run = {
        "tool": {"driver": driver},
        "artifacts": [{"location": _file_uri(path)} for path in file_names],
        "results": results,
        "columnKind": "unicodeCodePoints",
    }
    log = {"$schema": SCHEMA, "version": "2.1.0", "runs": [run]}
    return printable_json(log, indent=2) + "\n"


def _rule_object(rule: Rule) -> dict[str, Any]:
    rule_object: dict[str, Any] = {
        "id": rule.code,
        "shortDescription": {"text": rule.title},
        "defaultConfiguration": {"level": str(rule.severity)},
    }
    text = page_text(rule.code)
    if text is not None:
        plain_text = re.sub(r"(?m)^#+ |^```\w*\n|`", "", text)
        rule_object["help"] = {"text": plain_text, "markdown": text}
    return rule_object


def _result_object(
    fault: Fault, index_by_code: dict[str, int], sources: SourceLineCache
) -> dict[str, Any]:
    message = f"{fault.message}; {fault.hint}" if fault.hint else fault.message
    result: dict[str, Any] = {
        "ruleId": fault.code,
        **(
            {"ruleIndex": index_by_code[fault.code]}
            if fault.code in index_by_code
            else {}
        ),
        # Its levels are error, warning and note, too.
        "level": str(fault.severity),
        # Doubled braces are not placeholders (3.11.5).
        "message": {"text": message.replace("{", "{{").replace("}", "}}")},
    }
    if fault.path is None:
        return {**result, "partialFingerprints": _fingerprint(fault, None)}
    physical_location: dict[str, Any] = {"artifactLocation": _file_uri(fault.path)}
    line = None
    if fault.lines:
        line = sources.line(fault.path, fault.lines[0])
        physical_location["region"] = _region_object(fault, line)
    location: dict[str, Any] = {"physicalLocation": physical_location}
    if fault.where:
        location["logicalLocations"] = [{"fullyQualifiedName": fault.where}]
    result["locations"] = [location]
    return {**result, "partialFingerprints": _fingerprint(fault, line)}


def _region_object(fault: Fault, line: str | None) -> dict[str, Any]:
    region: dict[str, Any] = {"startLine": fault.lines[0]}
    if fault.column is not None:
        region["startColumn"] = fault.column
    # In a one-line file, every finding would contain the entire file.
    if line is not None and len(line) <= MAX_SNIPPET_LENGTH:
        region["snippet"] = {"text": line}
    return region


def _file_uri(path: str) -> dict[str, str]:
    """Return the URI of a file, relative if the path is relative."""
    pure_path = PurePath(path)
    if pure_path.is_absolute():
        return {"uri": pure_path.as_uri()}
    return {"uri": quote(os.fsencode(pure_path.as_posix()))}


def _fingerprint(fault: Fault, line: str | None) -> dict[str, str]:
    """Return a fingerprint of a finding that does not depend on its line number."""
    parts = (fault.code, fault.path or "", line or fault.where or fault.message)
    digest = hashlib.sha256("\0".join(parts).encode("utf-8", "replace")).hexdigest()
    return {"animtool/v1": digest[:32]}


def _number_duplicates(results: Sequence[dict[str, Any]]) -> None:
    """Make equal fingerprints unique by numbering them."""
    count_by_fingerprint: dict[str, int] = {}
    for result in results:
        fingerprints = result["partialFingerprints"]
        fingerprint = fingerprints["animtool/v1"]
        count_by_fingerprint[fingerprint] = count_by_fingerprint.get(fingerprint, 0) + 1
        fingerprints["animtool/v1"] = (
            f"{fingerprint}:{count_by_fingerprint[fingerprint]}"
        )
