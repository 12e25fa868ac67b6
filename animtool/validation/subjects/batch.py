"""A batch file, checked by its reader."""

from __future__ import annotations

from animtool.batch.file import batch_of_document
from animtool.documents.document import Document
from animtool.rules import Kind
from animtool.validation.subjects.subject import Opened


def open_batch(document: Document) -> Opened:
    """Return what a batch file asks for."""
    return Opened(Kind.BATCH, [], batch_of_document(document))
