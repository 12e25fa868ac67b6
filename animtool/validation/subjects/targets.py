"""A targets file as its rules see it."""

from __future__ import annotations

from dataclasses import dataclass

from animtool.documents.document import Document, Location
from animtool.errors import Fault
from animtool.ik.file import targets_of_document
from animtool.ik.tracks import TargetTracks
from animtool.rules import Kind
from animtool.validation.subjects.subject import CheckedFile, DocumentSubject


@dataclass(frozen=True, eq=False)
class TargetsSubject(DocumentSubject):
    """What is asked of a rig, and the file that says it."""

    targets: TargetTracks  # what it makes, of a rig that is not known

    def outside(
        self, goal: int, key: Location, message: str, first: float, last: float
    ) -> Fault:
        """Return a fault of what lies outside the file's range (TGT201)."""
        message += f"; the range is {first:g} to {last:g}"
        hint = "widen the range, or leave it out"
        return self.fault("TGT201", ("goals", goal, *key), message, hint)


def open_targets(document: Document) -> CheckedFile:
    """Return a targets file as its rules see it."""
    targets = targets_of_document(document, None)
    subject = TargetsSubject(document, targets)
    return CheckedFile(Kind.TARGETS, list(targets.notices), subject)
