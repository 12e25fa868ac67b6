"""Shots of an edit: clips of an OpenTimelineIO timeline and their media."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import field, replace
from fractions import Fraction
from math import ceil
from pathlib import Path
from typing import Any

from animtool.batch.cut_frames import (
    CutContext,
    CutOptions,
    build_shot,
    cut_metadata,
    media_values,
    shot_notices,
)
from animtool.batch.edl import TimelineBuilder, read_edl
from animtool.batch.spans import (
    ClipVisitor,
    ShownClip,
    Span,
    UnsupportedTimeError,
    shown_span,
    transition_offsets,
)
from animtool.batch.timeline import (
    FRAME_TOLERANCE,
    exact_rate,
    import_otio,
    is_edl,
    media_path,
    read_timeline,
    seconds_of,
)
from animtool.batch.timeline_rate import edl_rate, timeline_rate
from animtool.core.arguments import argument
from animtool.core.config import find_config
from animtool.core.errors import (
    Fault,
    FormatError,
    OptionError,
    Severity,
    counted,
    excerpt,
    first_faults,
    listed,
)
from animtool.core.files.reading import MatchedFile
from animtool.core.names import name_hint
from animtool.core.record import dataclass
from animtool.core.shot import Shot
from animtool.scene.sources.open import source_stem

# Maximum numbers of reported faults and of listed names.
MAX_FAULTS, MAX_LISTED_SHOTS = 100, 100
# Leaves room for the rest of a file name within the limits of disks.
MAX_NAME_LENGTH = 120
# Everything but characters that are safe in file names and variables.
_ILLEGAL_CHARACTERS = re.compile(r"[^A-Za-z0-9_-]+")


@dataclass(frozen=True, slots=True)
class Cut:
    """The media of one item: a clip of a timeline with its shot, or a plain file."""

    media: MatchedFile
    # Values of `SHOT_NAMES` for its scene and its output.
    shot_values: Mapping[str, str] = field(default_factory=dict)
    # Frames of the clip; None for a file outside of a timeline.
    shot: Shot | None = None


@dataclass(slots=True)
class CutList:
    """The shots of a timeline, with notices about clips that were left out."""

    shots: list[Cut] = field(default_factory=list)  # in its order
    # Notices about clips that were left out or changed.
    notices: list[Fault] = field(default_factory=list)


def read_cuts(
    path: Path,
    media: Sequence[MatchedFile] = (),
    options: CutOptions | None = None,
    is_excluded: Callable[[Path], bool] = lambda _: False,
) -> CutList:
    """Return the shots of a timeline: the clips of its video tracks.

    A clip's media is the file that it refers to. Without a reference, or if that file
    is missing, it is the entry of ``media`` with the name of the clip or of the file.
    Times are seconds of the media; a shot counts frames at the timeline's rate.
    """
    reader = _CutReader(path, media, options or CutOptions(), is_excluded)
    return reader.build_cuts(reader.visible_clips().clips)


def read_cut(path: Path, name: str | None, options: CutOptions) -> CutList:
    """Return a shot by its name, or the only one; raise BAT048 if there is none."""
    reader = _CutReader(path, (), options)
    visitor = reader.visible_clips()
    return reader.build_cuts(
        _shot_clips(visitor.clips, name, path, visitor.skip_reasons)
    )


def _shot_clips(
    shown_clips: Sequence[ShownClip],
    name: str | None,
    path: Path,
    skip_reasons: Mapping[str, str],
) -> list[ShownClip]:
    """Return the clip of a named shot, or the only clip; raise BAT048 if there is none.

    ``skip_reasons`` say why clips are not shots, by their names.
    """
    shot_names = [shown_clip.name for shown_clip in shown_clips]
    if name is not None and name not in shot_names and name in skip_reasons:
        message = f"has no shot {excerpt(name)}: {skip_reasons[name]}"
        raise OptionError(Fault("BAT048", message, str(path)))
    if not shot_names:
        message = "has no clip, so there is no shot to bake"
        raise OptionError(Fault("BAT048", message, str(path)))
    shots_text = f"the shots are {listed(shot_names, MAX_LISTED_SHOTS)}"
    if name is None:
        if len(shot_names) == 1:
            return list(shown_clips)
        message = (
            f"has {counted(len(shot_names), 'shot')}: name one with {argument('shot')}"
        )
        raise OptionError(Fault("BAT048", message, str(path), (), shots_text))
    if name not in shot_names:
        suggestion = name_hint(name, shot_names)
        hint = (
            f"{suggestion} {shots_text}" if suggestion.startswith("did") else shots_text
        )
        message = f"has no shot {excerpt(name)}"
        raise OptionError(Fault("BAT048", message, str(path), (), hint))
    return [shown_clip for shown_clip in shown_clips if shown_clip.name == name]


class _CutReader:
    """Reads the shots of a timeline, and collects its notices and faults."""

    def __init__(
        self,
        path: Path,
        media: Sequence[MatchedFile],
        options: CutOptions,
        is_excluded: Callable[[Path], bool] = lambda _: False,
    ) -> None:
        self.path, self.options, self.is_excluded = path, options, is_excluded
        self.cuts = CutList()
        self.faults: list[Fault] = []
        # Shot names, each with the highest number appended so far.
        self.used_names: dict[str, int] = {}
        self.timeline_metadata = CutOptions()
        self.fps = Fraction(0)
        # Kept alive, because clips refer to their parents weakly.
        self.loaded_timeline: Any = None
        self.is_drop_frame = False  # whether time codes of media are drop-frame
        self.media: dict[str, MatchedFile] = {}
        for file in media:
            self.media.setdefault(source_stem(file.path).casefold(), file)

    def visible_clips(self) -> ClipVisitor:
        """Return the visible clips, each with the name of its shot."""
        visitor = ClipVisitor(self.path)
        timeline = self.loaded_timeline = self.load_timeline()
        if timeline is None:
            return visitor
        try:
            visitor.visit_timeline(timeline.tracks)
        except (ValueError, import_otio().exceptions.OTIOError) as error:
            message = f"a range in it is invalid: {excerpt(str(error), 120)}"
            raise FormatError(Fault("BAT041", message, str(self.path))) from error
        self.cuts.notices += visitor.notices
        if visitor.gap_count:
            self.add_notice("BAT043", f"skipped gaps: {visitor.gap_count}")
        visitor.clips[:] = [
            self.with_shot_name(shown_clip) for shown_clip in visitor.clips
        ]
        return visitor

    def load_timeline(self) -> Any:
        """Read the timeline, its rate and metadata; return None if it has no events."""
        import_otio()
        if not is_edl(self.path):
            timeline = read_timeline(self.path)
            self.timeline_metadata = self.read_metadata(
                timeline, "the timeline", allows_fps=True
            )
            self.fps, notices = timeline_rate(
                timeline, self.path, self.timeline_metadata.fps, self.options.fps
            )
        else:
            edl = read_edl(self.path)
            if not edl.events:
                return None
            self.fps = edl_rate(edl, self.options.fps)
            self.is_drop_frame = edl.is_all_drop_frame
            timeline, notices = TimelineBuilder(edl, self.fps).build()
        self.cuts.notices += notices
        return timeline

    def build_cuts(self, shown_clips: Sequence[ShownClip]) -> CutList:
        """Return the shots of clips; raise all faults together."""
        for shown_clip in shown_clips:
            self.add_shot(shown_clip)
        if self.faults:
            raise FormatError(first_faults(self.faults, MAX_FAULTS, str(self.path)))
        return self.cuts

    def add_notice(
        self, code: str, message: str, severity: Severity = Severity.NOTE
    ) -> None:
        """Record a note or warning about the timeline."""
        fault = Fault(code, message, str(self.path), severity=severity)
        self.cuts.notices.append(fault)

    def add_fault(self, code: str, message: str, hint: str | None = None) -> None:
        """Record an error of the timeline, once."""
        fault = Fault(code, message, str(self.path), (), hint)
        if fault not in self.faults:
            self.faults.append(fault)

    def read_metadata(
        self, timeline_object: Any, owner_label: str, *, allows_fps: bool = False
    ) -> CutOptions:
        """Return the shot settings in the metadata of a clip or of the timeline."""
        options, faults = cut_metadata(
            timeline_object.metadata, owner_label, allows_fps=allows_fps
        )
        for message, hint in faults:
            self.add_fault("BAT047", message, hint)
        return options

    def with_shot_name(self, shown_clip: ShownClip) -> ShownClip:
        """Return a clip with the name of its shot."""
        path = self.referenced_path(shown_clip.clip)
        name = shown_clip.clip.name or ("" if path is None else source_stem(path))
        return replace(shown_clip, name=self.unique_name(name, shown_clip.clip_text))

    def add_shot(self, shown_clip: ShownClip) -> None:
        """Add the shot of a clip; record a fault or a notice if it has none."""
        # Imported here since it imports numpy, which planning a batch of files does not
        # need.
        from animtool.core.clock import MAX_FRAME_COUNT

        clip, clip_text = shown_clip.clip, shown_clip.clip_text
        media_file = self.find_media_file(clip, clip_text)
        if media_file is None:
            return
        metadata = (self.read_metadata(clip, clip_text), self.timeline_metadata)
        context = CutContext(self.options, *metadata, find_config(self.path))
        conflict = context.cut_in()[1]
        if conflict is not None:
            prefix = "" if conflict.is_general else f"{clip_text}: "
            self.add_fault("BAT047", prefix + conflict.message, "leave one of them out")
        media_range = clip.media_reference.available_range
        is_drop_frame = self.is_drop_frame
        try:
            span = shown_span(shown_clip)
            media_start, media_fps = None, span.rate
            if media_range is not None:
                media_start = seconds_of(media_range.start_time)
                media_fps = exact_rate(media_range.start_time.rate)
            media_time = context.first_timecode(
                media_start, span.rate, is_drop_frame=is_drop_frame
            )
            transitions = self.transition_frames(shown_clip, span)
        except UnsupportedTimeError as error:
            message = f"{clip_text}: {error}; it is skipped"
            self.add_notice("BAT044", message, Severity.WARNING)
            return
        except Exception as error:
            message = f"the range of {clip_text} is invalid: {excerpt(str(error), 120)}"
            self.add_fault("BAT041", message)
            return
        if span.seconds <= 0:
            self.add_fault("BAT041", f"{clip_text} shows no frame of its media")
            return
        shot_arguments = (span, self.fps, context, media_time, transitions)
        shot = build_shot(shown_clip.name, *shot_arguments, is_drop_frame=is_drop_frame)
        if shot.end - shot.start >= MAX_FRAME_COUNT:
            message = f"{clip_text} has too many frames: {shot.end - shot.start + 1}"
            self.add_fault(
                "BAT041", message, f"a shot can have up to {MAX_FRAME_COUNT}"
            )
            return
        for notice in shot_notices(shot, span, self.fps, clip_text):
            self.add_notice(*notice)
        shot_values = {
            "shot": shot.name,
            "clip": clip.name or "",
            "track": shown_clip.track,
            **shot.names(),
            **media_values(shot, media_fps),
        }
        self.cuts.shots.append(Cut(media_file, shot_values, shot))

    def referenced_path(self, clip: Any) -> Path | None:
        """Return the file that a clip refers to, which may be missing."""
        url = getattr(clip.media_reference, "target_url", None)
        return None if not url else media_path(str(url), self.path.parent)

    def find_media_file(self, clip: Any, clip_text: str) -> MatchedFile | None:
        """Return the media of a clip; None if it has none or it is missing."""
        path = self.referenced_path(clip)
        if path is not None and self.is_excluded(path):
            self.add_notice("BAT043", f"{clip_text} is skipped, as requested: {path}")
            return None
        if path is not None and _is_file(path):
            return MatchedFile(path, path.parent)
        # Some systems name clips after the full file name.
        names_without_type = (clip.name, None if path is None else source_stem(path))
        for stem in (*names_without_type, source_stem(Path(clip.name or ""))):
            if stem and stem.casefold() in self.media:
                return self.media[stem.casefold()]
        if path is not None:
            hint = "pass the folder that contains it, or a file with the clip's name, "
            hint += "as INPUT"
            problem = "a folder" if _is_file(path) is False else "not there"
            url = clip.media_reference.target_url
            # URLs that are not of a file are printed as they are.
            is_remote = "://" in url.removeprefix("file:///")
            message = f"the media of {clip_text} is {problem}: "
            self.add_fault("BAT042", f"{message}{url if is_remote else path}", hint)
        elif self.media:
            self.add_fault("BAT042", f"no media matches the name of {clip_text}")
        else:
            message = f"{clip_text} is skipped: it refers to no media"
            self.add_notice("BAT043", message, Severity.WARNING)
        return None

    def transition_frames(self, shown_clip: ShownClip, span: Span) -> tuple[int, int]:
        """Return the numbers of frames that transitions add before and after a cut."""
        transitions_and_ends = zip(
            transition_offsets(shown_clip),
            (span.shows_begin, span.shows_end),
            strict=True,
        )
        frames_before, frames_after = (
            ceil(seconds_of(transition) / shown_clip.speed * self.fps - FRAME_TOLERANCE)
            if transition is not None and is_end_visible
            else 0
            for transition, is_end_visible in transitions_and_ends
        )
        if frames_before or frames_after:
            message = f"{shown_clip.clip_text} is in transitions: {frames_before} "
            message += f"frames before its cut and {frames_after} after it are included"
            self.add_notice("BAT043", message)
        return frames_before, frames_after

    def unique_name(self, requested_name: str, clip_text: str) -> str:
        """Return a legal name that no earlier shot has."""
        legal_name = (
            _ILLEGAL_CHARACTERS.sub("_", requested_name).strip("_-")[:MAX_NAME_LENGTH]
            or "shot"
        )
        name, number = legal_name, self.used_names.get(legal_name.casefold(), 1)
        while name.casefold() in self.used_names:
            number += 1
            name = f"{legal_name}_{number}"
        self.used_names[name.casefold()] = 1
        self.used_names[legal_name.casefold()] = number
        if name != requested_name:
            self.add_notice("BAT046", f"{clip_text} is the shot {name}")
        return name


def _is_file(path: Path) -> bool | None:
    """Return whether a path is a file; None if it does not exist."""
    try:
        return path.is_file() or (False if path.exists() else None)
    except (OSError, ValueError):
        # A name that no disk can have.
        return None
