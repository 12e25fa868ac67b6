"""Base types of subjects, and reader findings."""

from __future__ import annotations

from dataclasses import field
from typing import TYPE_CHECKING, Any

from animtool.core.errors import Fault
from animtool.core.record import dataclass
from animtool.core.rules import Kind
from animtool.documents.document import Document, Location

if TYPE_CHECKING:
    from animtool.validation.motion.subject import MotionSubject


@dataclass(slots=True)
class CheckedFile:
    """A file that was read as far as possible."""

    kind: Kind  # what it is
    # What its reader refused and noticed.
    faults: list[Fault] = field(default_factory=list)
    # What the rules of its kind look at; None where the reader refused it.
    subject: Any = None
    document: Document | None = None  # its text; None of files that people do not write
    # What moves in it, one entry a character or take, for motion rules.
    takes: tuple[MotionSubject, ...] = ()
    # Name of the severity profile that its content asks for, if any.
    profile: str | None = None


@dataclass(frozen=True, eq=False)
class DocumentSubject:
    """Content of a document, with locations."""

    document: Document  # the file

    def fault(
        self, code: str, location: Location, message: str, hint: str | None = None
    ) -> Fault:
        """Return a fault at a location of the file, or the nearest parent."""
        return self.document.fault(code, location, message, hint)
