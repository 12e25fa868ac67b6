"""A targets file as its rules see it."""

from __future__ import annotations

from dataclasses import dataclass

from animtool.documents.document import Document
from animtool.ik.file import targets_of_document
from animtool.ik.tracks import TargetTracks
from animtool.validation.rule import Kind
from animtool.validation.subjects.subject import DocumentSubject, Opened

__all__ = ["TargetsSubject", "open_targets"]


@dataclass(frozen=True, eq=False)
class TargetsSubject(DocumentSubject):
    """What is asked of a rig, and the file that says it.

    Attributes:
        targets: What it makes, of a rig that is not known.
    """

    targets: TargetTracks


def open_targets(document: Document) -> Opened:
    """Return a targets file as its rules see it.

    Raises:
        FormatError: With every fault of the file.
    """
    targets = targets_of_document(document, None)
    subject = TargetsSubject(document, targets)
    return Opened(Kind.TARGETS, list(targets.notices), subject)
