"""Base types of subjects, and reader findings."""

from __future__ import annotations

from dataclasses import field
from typing import TYPE_CHECKING, Any

from animtool.core.errors import Fault
from animtool.core.record import dataclass
from animtool.core.rules import Kind

if TYPE_CHECKING:
    from animtool.documents.document import Document, Location
    from animtool.validation.motion.subject import MotionSubject


@dataclass(slots=True)
class CheckedFile:
    """A file that was read as far as possible."""

    kind: Kind  # kind of the file
    # Faults and notices of its reader.
    faults: list[Fault] = field(default_factory=list)
    # Subject of the rules of its kind; None if the reader refused the file.
    subject: Any = None
    # Its text; None for files that are not written by hand.
    document: Document | None = None
    # Its motion for the motion rules, one entry per character or take.
    takes: tuple[MotionSubject, ...] = ()
    # Name of the severity profile requested by its content, if any.
    profile: str | None = None


@dataclass(frozen=True, eq=False)
class DocumentSubject:
    """Base of subjects that are read from a document; locates faults in it."""

    document: Document  # the file

    def fault(
        self, code: str, location: Location, message: str, hint: str | None = None
    ) -> Fault:
        """Return a fault at a location of the file, or the nearest parent."""
        return self.document.fault(code, location, message, hint)
