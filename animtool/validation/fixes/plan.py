"""Plans fixes of a file in memory, each step validated before the next."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import field, replace
from pathlib import Path
from typing import TypeAlias

from animtool.core.errors import Fault
from animtool.core.names import DOCUMENT_FILE_SUFFIXES
from animtool.core.readers import READERS, USD
from animtool.core.record import dataclass
from animtool.validation.fixes.draft import FileDraft, FixStepResult, has_fix
from animtool.validation.options import ValidateOptions, settings_of
from animtool.validation.run import Report


@dataclass(slots=True)
class FixPlan:
    """Planned fixes of a file: its fixed content, and the findings that remain."""

    path: Path  # the file
    draft: FileDraft  # its content after the fixes
    # Fixed findings in order, with their fixes.
    fixed_findings: list[tuple[Fault, str]] = field(default_factory=list)
    # Findings with a fix that remain, and why.
    unfixed_findings: list[tuple[Fault, str]] = field(default_factory=list)


def plan_fixes(path: Path, options: ValidateOptions) -> FixPlan:
    """Apply all safe fixes of a file in memory, with its project settings.

    A fix is kept if its finding disappears and no new one appears.
    """
    options = options.merged_over(settings_of(path))
    plan = FixPlan(path, _open_draft(path))
    options = options.with_profile(plan.draft.checked_file.profile)
    tried_keys: set[_FaultKey] = set()
    while findings := _untried_findings(plan.draft.findings, options, tried_keys):
        findings_to_fix = plan.draft.next_batch(findings)
        step = plan.draft.fix_batch(findings_to_fix)
        reason = _reason_to_reject(plan.draft, step)
        if step.fixed_findings and not reason:
            plan.draft = step.draft
            plan.fixed_findings.extend(step.fixed_findings)
            # Other findings may have moved, and may be fixable now.
            tried_keys.clear()
            plan.unfixed_findings.clear()
            continue
        tried_keys.update(map(_fault_key, findings_to_fix))
        plan.unfixed_findings.extend(step.unfixed_findings)
        plan.unfixed_findings.extend((f, reason) for f, _ in step.fixed_findings)
    remaining_findings = _untried_findings(plan.draft.findings, options, set())
    final_step = plan.draft.fix_deferred(remaining_findings)
    plan.draft = final_step.draft
    plan.fixed_findings.extend(final_step.fixed_findings)
    return plan


def mark_fixable(report: Report) -> Report:
    """Return the report with `Report.fixable`, the findings with a safe fix."""
    fixable_by_path: dict[str, list[Fault]] = {}
    for fault in report.findings:
        path = Path(fault.path or "")
        if is_fixable(path) and not is_package(path) and has_fix(fault.code):
            fixable_by_path.setdefault(str(fault.path), []).append(fault)
    fixable_faults = (
        fault
        for fixable_path, faults in fixable_by_path.items()
        for fault in _open_draft(Path(fixable_path)).fixable_findings(faults)
    )
    return replace(report, fixable=frozenset(fixable_faults))


def is_layer(path: Path) -> bool:
    """Return whether a file is a USD layer, whose fix is written as a copy.

    >>> is_layer(Path("shot.usdc")), is_layer(Path("hero.rig.yaml"))
    (True, False)
    """
    return READERS.get(path.suffix.lower()) is USD


def is_package(path: Path) -> bool:
    """Return whether a file is a USD package, whose layers are read-only.

    >>> is_package(Path("shot.usdz")), is_package(Path("shot.usdc"))
    (True, False)
    """
    return path.suffix.lower() == ".usdz"


def is_fixable(path: Path) -> bool:
    """Return whether files of a kind can be fixed: documents and USD.

    >>> [is_fixable(Path(n)) for n in ("a.rig.yaml", "a.usda", "a.bvh", "a.glb")]
    [True, True, False, False]
    """
    return path.suffix.lower() in DOCUMENT_FILE_SUFFIXES or is_layer(path)


def _open_draft(path: Path) -> FileDraft:
    """Return the draft of a file, unchanged."""
    if is_layer(path):
        from animtool.validation.fixes.layers import LayerDraft

        return LayerDraft(path)
    from animtool.validation.fixes.texts import TextDraft

    return TextDraft.read(path)


_FaultKey: TypeAlias = tuple[str, str | None, str]


def _untried_findings(
    faults: Sequence[Fault], options: ValidateOptions, tried_keys: set[_FaultKey]
) -> list[Fault]:
    """Return the selected findings that have a fix which was not tried yet."""
    findings = [f for f in faults if has_fix(f.code) and options.selects(f.code)]
    return [fault for fault in findings if _fault_key(fault) not in tried_keys]


def _fault_key(fault: Fault) -> _FaultKey:
    return fault.code, fault.where, fault.message


def _reason_to_reject(old_draft: FileDraft, step: FixStepResult) -> str:
    """Return a reason if findings remain or appear after a fix, else ""."""
    if not step.fixed_findings:
        return ""
    old_counts = Counter(fault.code for fault in old_draft.findings)
    new_counts = Counter(fault.code for fault in step.draft.findings)
    added_codes = sorted(new_counts - old_counts)
    if added_codes:
        return f"the fix would cause {added_codes[0]}"
    fixed_codes = {fault.code for fault, _ in step.fixed_findings}
    if any(new_counts[code] >= old_counts[code] for code in fixed_codes):
        return "the finding would remain"
    return ""
