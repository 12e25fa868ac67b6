"""Clip files as subjects."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property

import numpy as np

from animtool.clip.channels import ClipUnits
from animtool.clip.clip import Clip
from animtool.clip.file import (
    check_clip,
    clip_of_document,
    file_units,
    load_clip,
    load_clip_rig,
)
from animtool.core.array_types import BoolArray
from animtool.core.errors import AnimtoolError, Fault, Severity
from animtool.core.record import dataclass
from animtool.core.rules import Kind
from animtool.documents.document import Document, Location
from animtool.maths.curves import Interp
from animtool.motion.take import Take
from animtool.rig.skeleton import Rig
from animtool.scene.sources.clips import clip_stream
from animtool.validation.motion.subject import MotionSubject
from animtool.validation.subjects.subject import CheckedFile, DocumentSubject


@dataclass(frozen=True, eq=False)
class ClipSubject(DocumentSubject):
    """Subject of clip rules: a clip on its rig, and as a sampled take."""

    clip: Clip  # the clip of the file
    rig: Rig  # the rig it animates
    take: Take  # the sampled clip
    units: ClipUnits  # of the numbers in the file

    @cached_property
    def time_codes(self) -> list[float]:
        """Time codes of the sampled take's frames."""
        return [float(time_code) for time_code in self.take.clock.times]

    def key_location(self, joint: str, frame: float) -> Location:
        """Return the location of the last key up to a frame in a joint's first channel.

        If the joint has no channel, this is the location of the list of channels.
        """
        for i, channel in enumerate(self.clip.channels):
            if channel.target.startswith(f"joint/{joint}."):
                return self.previous_key(i, frame)
        return ("channels",)

    def fault_at(
        self, code: str, joint: str, frame: float | None, message: str, hint: str
    ) -> Fault:
        """Return a fault of a joint at a frame, located at its previous key."""
        location: Location = ("channels",)
        if joint and frame is not None:
            location = self.key_location(joint, frame)
        return self.fault(code, location, message, hint)

    @cached_property
    def cut_mask(self) -> BoolArray:
        """Mask of frame intervals that contain a stepped key ``(F - 1,)``."""
        frames = np.array(self.time_codes)
        is_cut = np.zeros(len(frames) - 1, bool)
        for channel in self.clip.channels:
            for k, interp in enumerate(channel.interps[:-1]):
                if interp is Interp.STEP:
                    key_frame = channel.times[k + 1]
                    is_cut |= (frames[:-1] < key_frame) & (key_frame <= frames[1:])
        return is_cut

    def previous_key(self, channel_index: int, frame: float) -> Location:
        """Return the last key of a channel up to a frame, else the first key."""
        times = self.clip.channels[channel_index].times
        k = max(int(np.searchsorted(times, frame, "right")) - 1, 0)
        return ("channels", channel_index, "keys", k)


def open_clip_document(document: Document) -> CheckedFile:
    """Read a clip file and sample it on the rig that it names.

    Without a rig, everything that does not need one is checked, and a note says so.
    """
    file = clip_of_document(document)
    if file.model.rig is None:
        check_clip(file)
        message = "names no rig, so its targets cannot be checked"
        hint = "write 'rig: hero.rig.yaml' into it"
        fault = document.fault("CLIP011", ("clip",), message, hint)
        return CheckedFile(Kind.CLIP, [replace(fault, severity=Severity.NOTE)])
    rig = load_clip_rig(file)
    clip = load_clip(file, rig)
    checked_file = CheckedFile(Kind.CLIP, list(clip.notices))
    try:
        take = clip_stream(file, clip, rig).collect()
    except AnimtoolError as error:
        checked_file.faults += [fault.in_file(document.path) for fault in error.faults]
        return checked_file
    checked_file.faults += take.notices
    take = replace(take, notices=(*take.notices, *clip.notices))
    subject = ClipSubject(document, clip, rig, take, file_units(file.model, rig))
    motion = MotionSubject(
        take,
        subject.fault_at,
        is_intended_cut=subject.cut_mask,
        file_format="clip",
    )
    checked_file.subject, checked_file.takes = subject, (motion,)
    return checked_file
