"""Test helper for authors of rules."""

from __future__ import annotations

from pathlib import Path

from animtool.core.rules import Rule
from animtool.validation.run import Finding, findings_of_rule


def check_rule(rule: Rule, wrong: Path | str, right: Path | str) -> list[Finding]:
    """Check that a rule reports a fault in one file and none in another.

    Args:
        rule: The rule to test.
        wrong: A file with the fault.
        right: A similar file without the fault.

    Returns:
        The findings in the wrong file.

    Raises:
        AssertionError: The rule fails the test, or a finding is incomplete: without
            file, line or prim, with a wrong code, or with an empty message.
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
    false_findings = findings_of_rule(rule, Path(right))
    if false_findings:
        raise AssertionError(
            f"{rule.code} is a false alarm in {right}: {false_findings[0]}"
        )
    return findings
