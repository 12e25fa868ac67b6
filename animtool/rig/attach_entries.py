"""What simulations move, of a rig file."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from animtool.documents.document import Document, Location
from animtool.documents.names import nearest
from animtool.rig.array_entries import ArrayReader
from animtool.rig.attach_schema import AttachModel
from animtool.rig.parts import AttachKind, Attachment
from animtool.similar import similar

Check = Callable[[Location, str], object]

# The keys that an attachment of a kind wants, and those that it takes beside.
_KEYS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    AttachKind.SPRING_CHAIN: (("joints",), ()),
    AttachKind.CLOTH: (("mesh",), ("pins",)),
    AttachKind.STRANDS: (("joint", "points"), ()),
}
# A name this near to that of a known kind is a slip, and no kind of somebody's own.
SLIP = 0.8


@dataclass(frozen=True, slots=True)
class AttachmentReader:
    """Makes attachments one at a time; what is wrong is noted in the document.

    Attributes:
        document: The file.
        arrays: Looks at the arrays that the file refers to.
        vertices: Number of points of each mesh; None where it is not known.
        check_joint: Notes a name that is no joint.
        check_mesh: Notes a name that is no mesh.
    """

    document: Document
    arrays: ArrayReader
    vertices: Mapping[str, int | None]
    check_joint: Check
    check_mesh: Check

    def attachment(self, at: Location, entry: AttachModel) -> Attachment:
        """Return an attachment; faults are noted in the document."""
        self._fitting_keys(at, entry)
        joints = tuple(entry.joints or ())
        for k, name in enumerate(joints):
            self.check_joint((*at, "joints", k), name)
        if entry.joint is not None:
            self.check_joint((*at, "joint"), entry.joint)
            joints = (entry.joint,)
        if entry.mesh is not None:
            self.check_mesh((*at, "mesh"), entry.mesh)
        pins = None
        if entry.pins is not None:
            count = self.vertices.get(entry.mesh or "")
            spot = (*at, "pins")
            pins = self.arrays.array(spot, entry.pins, "pins", (None,), count)
        points = None
        if entry.points is not None:
            spot, shape = (*at, "points"), (None, None, 3)
            points = self.arrays.array(spot, entry.points, "strands", shape)
        return Attachment(
            entry.name, entry.kind, joints, entry.mesh or "", pins, points
        )

    def _fitting_keys(self, at: Location, entry: AttachModel) -> None:
        """Note the keys that an attachment's kind lacks, or does not take."""
        if self.document.doubtful((*at, "kind")):
            return
        wants, takes = _KEYS.get(entry.kind, _KEYS[AttachKind.SPRING_CHAIN])
        every = ("joints", "joint", "mesh", "pins", "points")
        given = [key for key in every if getattr(entry, key) is not None]
        hint = f"it has {', '.join((*wants, *takes))}"
        if entry.kind not in _KEYS:
            kinds = [str(kind) for kind in AttachKind]
            hint = nearest(entry.kind, kinds)
            if similar(entry.kind, kinds, SLIP):
                message = f"no known kind of attachment is called {entry.kind!r}"
                self.document.warn("RIG102", (*at, "kind"), message, hint)
        for key in wants:
            sure = not self.document.doubtful((*at, key))
            if key not in given and sure and "attach" not in self.document.partial:
                message = f"an attachment of kind {entry.kind!r} has no {key}"
                self.document.add("RIG031", at, message, hint)
        for key in given:
            if key not in (*wants, *takes):
                message = f"an attachment of kind {entry.kind!r} takes no {key}"
                self.document.add("RIG031", (*at, key), message, hint)
