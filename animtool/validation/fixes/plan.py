"""Plans fixes of a file in memory, each step validated before the next."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import field, replace
from pathlib import Path

from animtool.core.errors import Fault
from animtool.core.readers import FBX, GLTF, READERS, USD
from animtool.core.record import dataclass
from animtool.validation.fixes.draft import FileDraft, FixStep, has_fix
from animtool.validation.options import ValidateOptions
from animtool.validation.run import Report


@dataclass(slots=True)
class FileMend:
    """A file and its fixed content."""

    path: Path  # the file
    after: FileDraft  # its content when mended
    # Findings in the order they were fixed, and the fix.
    mended: list[tuple[Fault, str]] = field(default_factory=list)
    # Findings of a code that has a fix, and why they stay.
    left: list[tuple[Fault, str]] = field(default_factory=list)

    def difference(self) -> str:
        """Return the changes as text."""
        return self.after.difference()


def plan_file(path: Path, options: ValidateOptions) -> FileMend:
    """Return a file with all safe fixes applied in memory.

    A mend is kept where its finding is gone and none has come.
    """
    plan = FileMend(path, _open_draft(path))
    options = options.with_profile(plan.after.checked.profile)
    unfixable: set[tuple[str, str | None, str]] = set()
    while cases := list(_open_cases(plan.after.findings, options, unfixable)):
        batch = plan.after.batch(cases)
        step = plan.after.step(batch)
        worse = _worse(plan.after, step)
        if step.done and not worse:
            plan.after = step.draft
            plan.mended.extend(step.done)
            # The others may have moved, and succeed now.
            unfixable.clear()
            plan.left.clear()
            continue
        unfixable.update(map(_key, batch))
        plan.left.extend(step.refused)
        plan.left.extend((fault, worse) for fault, _ in step.done)
    last = plan.after.finish(list(_open_cases(plan.after.findings, options, set())))
    plan.after = last.draft
    plan.mended.extend(last.done)
    return plan


def with_fixable(report: Report) -> Report:
    """Return a report that marks findings with a safe fix."""
    cases: dict[str, list[Fault]] = {}
    for fault in report.findings:
        if fault.path is None or is_package(Path(fault.path)):
            continue
        if not has_fixes(Path(fault.path)):
            continue
        if has_fix(fault.code):
            cases.setdefault(fault.path, []).append(fault)
    fixable = (
        fault
        for path, faults in cases.items()
        for fault in _open_draft(Path(path)).fixable(faults)
    )
    return replace(report, fixable=frozenset(fixable))


def is_layer(path: Path) -> bool:
    """Return whether a file is a USD layer, which is fixed as a copy.

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


def has_fixes(path: Path) -> bool:
    """Return whether files of a kind can be fixed: texts and USD.

    >>> has_fixes(Path("walk.bvh")), has_fixes(Path("fox.glb"))
    (True, False)
    """
    return READERS.get(path.suffix.lower()) not in {GLTF, FBX}


def _open_draft(path: Path) -> FileDraft:
    """Return the draft of a file, unchanged."""
    if is_layer(path):
        from animtool.validation.fixes.layers import LayerDraft

        return LayerDraft(path)
    from animtool.validation.fixes.texts import TextDraft

    return TextDraft.read(path)


def _open_cases(
    faults: Sequence[Fault],
    options: ValidateOptions,
    unfixable: set[tuple[str, str | None, str]],
) -> Iterator[Fault]:
    """Yield findings that count, have a fix, and were not tried yet."""
    for fault in faults:
        fixable = has_fix(fault.code) and options.counts(fault.code)
        if fixable and _key(fault) not in unfixable:
            yield fault


def _key(fault: Fault) -> tuple[str, str | None, str]:
    return fault.code, fault.where, fault.message


def _worse(before: FileDraft, step: FixStep) -> str:
    """Return why a step is rejected: findings remain or appear; empty if accepted."""
    if not step.done:
        return ""
    old = Counter(fault.code for fault in before.findings)
    new = Counter(fault.code for fault in step.draft.findings)
    more = sorted(code for code in new if new[code] > old[code])
    if more:
        return f"the fix would cause {more[0]}"
    if any(new[fault.code] >= old[fault.code] for fault, _ in step.done):
        return "the finding would remain"
    return ""
