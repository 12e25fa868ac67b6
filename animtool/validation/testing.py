"""Test helper for authors of rules."""

from __future__ import annotations

from pathlib import Path

from animtool.core.rules import Rule
from animtool.validation.run import Finding, findings_of_rule


def check_rule(rule: Rule, wrong: Path | str, right: Path | str) -> list[Finding]:
    """Check that a rule finds a fault in one file, and none in another.

    Args:
        rule: To be tested.
        wrong: A file with the fault.
        right: One that nearly has it, and has not.

    Returns:
        What it finds in the wrong file.

    Raises:
        AssertionError: The rule does otherwise, or what it says is of no use: a file,
            line or prim is missing, the code is another, the message is empty.
    """
    findings = findings_of_rule(rule, Path(wrong))
    if not findings:
        raise AssertionError(f"{rule.code} finds nothing in {wrong}")
    for finding in findings:
        if finding.code != rule.code:
            raise AssertionError(f"{rule.code} reports {finding.code}")
        if not finding.message or finding.path is None:
            raise AssertionError(f"{rule.code} reports nothing, or no file: {finding}")
        if not finding.lines and not finding.where:
            raise AssertionError(f"{rule.code} reports no location: {finding}")
    others = findings_of_rule(rule, Path(right))
    if others:
        raise AssertionError(f"{rule.code} is a false alarm in {right}: {others[0]}")
    return findings
