"""Rest poses that only the bind pose has."""

from __future__ import annotations

from animtool.documents.edit import Add
from animtool.errors import Fault
from animtool.validation.fixes.mend import Mend
from animtool.validation.fixes.places import place_of
from animtool.validation.subjects.rig import RigSubject
from animtool.validation.subjects.subject import Opened


def from_bind(opened: Opened, fault: Fault) -> Mend:
    """Return the file with a joint's rest pose, taken from its bind pose."""
    rig: RigSubject = opened.subject
    place = place_of(fault)
    entry = rig.written("joints")[place[1]]
    pose = rig.document.value["bind"][entry["name"]]
    keys = [key for key in ("translate", "rotate") if pose.get(key) is not None]
    edits = tuple(Add(place, key, pose[key]) for key in keys)
    return Mend(f"gives {entry['name']!r} the rest pose that bind has", edits)
