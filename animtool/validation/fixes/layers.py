"""Fixes USD layers in memory, all findings of one code at once."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from animtool.core.errors import Fault
from animtool.core.record import dataclass
from animtool.usd.fixes.table import EDITS_BY_CODE
from animtool.validation.fixes.draft import FixStepResult
from animtool.validation.run import findings_in
from animtool.validation.subjects.open import open_file
from animtool.validation.subjects.subject import CheckedFile

if TYPE_CHECKING:
    from animtool.usd.fixes.target import FixTarget


@dataclass(frozen=True, eq=False)
class LayerDraft:
    """The content of a USD layer; composed layers stay unchanged."""

    path: Path  # the file
    content: Any = None  # content of the layer; None uses the file's
    edits: tuple[str, ...] = ()  # descriptions of the edits, one line each

    @cached_property
    def checked_file(self) -> CheckedFile:
        """The parsed content, as the subject of the rules."""
        from animtool.usd.fixes.target import edited_layer

        with edited_layer(self.path, self.content):
            return open_file(self.path)

    @cached_property
    def findings(self) -> Sequence[Fault]:
        """Findings of all rules in the layer with its edits."""
        return findings_in(self.checked_file)

    def next_batch(self, findings: Sequence[Fault]) -> Sequence[Fault]:
        """Return the findings of the first code to fix, deepest prims first.

        The extent of a prim depends on its descendants.
        """
        codes = {fault.code for fault in findings}
        first_code = next(code for code in EDITS_BY_CODE if code in codes)
        matches = (fault for fault in findings if fault.code == first_code)
        return sorted(matches, key=lambda fault: -(fault.where or "").count("/"))

    def fix_batch(self, faults: Sequence[Fault]) -> FixStepResult:
        """Return the layer with findings fixed; list those whose fix is refused."""
        from animtool.usd.fixes.target import edited_layer

        fixed_findings: list[tuple[Fault, str]] = []
        refused_findings: list[tuple[Fault, str]] = []
        with edited_layer(self.path, self.content) as layer:
            for fault in faults:
                reason, remedy = _apply_fix(layer, fault)
                results = refused_findings if reason else fixed_findings
                results.append((fault, reason or remedy))
            content = layer.content()
        edit_lines = [
            f"{self.path}: {fault.code} {remedy}" for fault, remedy in fixed_findings
        ]
        edited_draft = LayerDraft(self.path, content, (*self.edits, *edit_lines))
        return FixStepResult(
            edited_draft if fixed_findings else self, fixed_findings, refused_findings
        )

    def fix_deferred(self, _: Sequence[Fault], /) -> FixStepResult:
        """Return the layer unchanged: no fix is deferred."""
        return FixStepResult(self)

    def fixable_findings(self, faults: Sequence[Fault]) -> Iterator[Fault]:
        """Yield the findings in this layer that have a safe fix."""
        from animtool.usd.fixes.target import NotFixableError, edited_layer

        with edited_layer(self.path, self.content) as layer:
            for fault in faults:
                try:
                    layer.find_edit(fault)
                except NotFixableError:
                    continue
                yield fault

    def diff_text(self) -> str:
        """Return the edits, one per line: a crate has no text diff."""
        return "".join(f"{line}\n" for line in self.edits)

    def outputs(self) -> Sequence[Path]:
        """Return an empty list: fixing a layer writes no additional files."""
        return ()

    def write(self, output: Path) -> Sequence[str]:
        """Write the layer to a file; return descriptions of other changes in it."""
        from animtool.usd.fixes.target import write_copy

        return write_copy(self.path, self.content, output)


def _apply_fix(layer: FixTarget, fault: Fault) -> tuple[str, str]:
    """Fix a finding in a layer; return why it was refused, and what was changed.

    One of the two is empty.
    """
    from animtool.usd.fixes.target import NotFixableError

    prefix = "" if fault.where in {None, "/"} else f"{fault.where}: "
    try:
        return "", f"{prefix}{layer.find_edit(fault)()}"
    except NotFixableError as error:
        return f"{prefix}{error}", ""
