"""A marker template: markers on the joints of a rig, and its text."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import field
from pathlib import Path

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import AnimtoolError, Fault, FormatError, OptionError, listed
from animtool.core.names import decimal_text, flow_list, name_hint, yaml_scalar
from animtool.core.record import dataclass
from animtool.documents.document import Document, location_text
from animtool.rig.parts import Vector
from animtool.rig.skeleton import Rig

# Decimals of a written offset [m]: finer than a camera can resolve.
OFFSET_DECIMALS = 6


@dataclass(frozen=True, slots=True)
class TemplateMarker:
    """A marker of a template: where it is on a rig, and its names in captures.

    Attributes:
        name: Name in captures, without the subject prefix.
        joint: Name of the joint that carries it.
        offset: Position in the joint's frame [m].
        weight: Weight in a solve; 0 ignores it.
        fixed: Whether calibration keeps its offset.
        aliases: Other names in captures.
    """

    name: str
    joint: str
    offset: Vector = (0.0, 0.0, 0.0)
    weight: float = 1.0
    fixed: bool = False
    aliases: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class MarkerTemplate:
    """Markers on the joints of a rig.

    Attributes:
        markers: The M markers, unique by name and alias.
        rig: Path of the rig file it names; None if it names none.
        document: The file it was read from; None if it is not from a file.
    """

    markers: tuple[TemplateMarker, ...]
    rig: Path | None = None
    document: Document | None = field(default=None, repr=False, compare=False)

    @property
    def names(self) -> list[str]:
        """Names of the markers, in order."""
        return [marker.name for marker in self.markers]

    @property
    def offsets(self) -> FloatArray:
        """Offsets of the markers ``(M, 3)`` [m], in the frames of their joints."""
        return np.array([m.offset for m in self.markers], np.float64).reshape(-1, 3)

    @property
    def weights(self) -> FloatArray:
        """Weights of the markers ``(M,)`` [1]."""
        return np.array([m.weight for m in self.markers], np.float64)

    def joints(self, rig: Rig) -> IntArray:
        """Return the index of each marker's joint ``(M,)``.

        Raises:
            FormatError: The rig lacks a joint (MKT001), with every such marker of the
                file; OptionError if the template is not from a file.

        >>> from animtool.rig.skeleton import Joint
        >>> rig = Rig("arm", (Joint("a", -1), Joint("b", 0)))
        >>> MarkerTemplate((TemplateMarker("WRA", "b"),)).joints(rig).tolist()
        [1]
        """
        joint_indices = {name: j for j, name in enumerate(rig.names)}
        faults = []
        for i, marker in enumerate(self.markers):
            if marker.joint in joint_indices:
                continue
            message = f"{marker.name!r} is on {marker.joint!r}, which {rig.name!r} "
            message += "lacks"
            key_path = ("marker_set", i, "joint")
            hint = name_hint(marker.joint, joint_indices)
            faults.append(
                Fault("MKT001", message, hint=hint, where=location_text(key_path))
                if self.document is None
                else self.document.fault("MKT001", key_path, message, hint)
            )
        if faults:
            faults = self._merge_rig_faults(rig, faults)
            raise OptionError(faults) if self.document is None else FormatError(faults)
        return np.array([joint_indices[m.joint] for m in self.markers], np.int64)

    def _merge_rig_faults(self, rig: Rig, faults: list[Fault]) -> list[Fault]:
        """Return one fault for all if the template's own rig has their joints."""
        if self.document is None or self.rig is None or len(faults) < 2:
            return faults
        try:
            named_rig = Rig.load(self.rig)
        except AnimtoolError:
            return faults
        joint_names = {marker.joint for marker in self.markers}
        if not joint_names <= set(named_rig.names):
            return faults
        missing_joints = [repr(name) for name in sorted(joint_names - set(rig.names))]
        message = f"{len(faults)} of {len(self.markers)} markers are on joints that "
        message += f"{rig.name!r} lacks: {listed(missing_joints, 4)}"
        hint = f"the template is for {self.rig.name}, which has them; use its rig, or "
        hint += f"a template of {rig.name!r}"
        return [self.document.fault("MKT001", ("rig",), message, hint)]


def template_text(template: MarkerTemplate, title: str, rig: str | None = None) -> str:
    """Format a template as the text of a template file.

    The title is a comment on the first line; ``rig`` the path of the rig file, None
    omits it.
    """
    return "\n".join(_template_lines(template, title, rig)) + "\n"


def _template_lines(
    template: MarkerTemplate, title: str, rig: str | None
) -> Iterator[str]:
    """Yield the lines of a template file."""
    yield f"# {title}"
    yield "markers: animtool/1"
    if rig is not None:
        yield f"rig: {yaml_scalar(rig)}"
    yield "marker_set:"
    for marker in template.markers:
        offset = flow_list(
            [decimal_text(round(x, OFFSET_DECIMALS)) for x in marker.offset]
        )
        line = f"name: {yaml_scalar(marker.name)}, joint: {yaml_scalar(marker.joint)}"
        line += f", offset: {offset}"
        if marker.weight != 1.0:
            line += f", weight: {decimal_text(marker.weight)}"
        if marker.fixed:
            line += ", fixed: true"
        if marker.aliases:
            aliases = [yaml_scalar(name) for name in marker.aliases]
            line += f", aliases: {flow_list(aliases)}"
        yield f"- {{{line}}}"
