"""Entries of ignore that hide nothing."""

from __future__ import annotations

from animtool.documents.edit import Remove
from animtool.errors import Fault
from animtool.validation.fixes.mend import Mend, NotMendedError
from animtool.validation.fixes.places import place_of
from animtool.validation.subjects.subject import Opened


def left_out(opened: Opened, fault: Fault) -> Mend:
    """Return the file without an entry, and without the list that it was alone in."""
    if opened.document is None:
        raise NotMendedError("the file has no text")
    entries = opened.document.value["ignore"]
    place = place_of(fault)
    entry = entries[place[1]]
    location = place if len(entries) > 1 else ("ignore",)
    return Mend(f"leaves out the entry for {entry['code']}", (Remove(location),))
