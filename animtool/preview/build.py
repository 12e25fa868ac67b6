"""Pages: files read, put on one timeline, and written as one HTML file."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from animtool.core.clock import frame_label
from animtool.core.errors import Fault, OptionError, Severity, counted
from animtool.core.files.output import check_outputs, sparing_inputs, write_parts
from animtool.core.names import is_named
from animtool.core.rates import rate_label
from animtool.core.shot import FrameRange
from animtool.core.units import UpAxis, up_from_up
from animtool.maths import so3
from animtool.motion.markers import Markers
from animtool.motion.take import TakeStream
from animtool.preview.channels import add_channels
from animtool.preview.draft import Draft, Timeline
from animtool.preview.findings import (
    MAX_FINDINGS,
    find_faults,
    finding_entry,
    ordered,
)
from animtool.preview.meshes import add_character
from animtool.preview.opened import OpenFile, OpenTake, open_file
from animtool.preview.options import PreviewOptions
from animtool.preview.page import page_parts
from animtool.preview.streams import quantized_range
from animtool.preview.takes import Gathered, Shown, add_take
from animtool.scene.bake.first_frame import frame_start
from animtool.scene.bake.frames import in_frames
from animtool.scene.bake.options import BakeOptions

if TYPE_CHECKING:
    from animtool.usd.caches.shown import StageContents

# Frames of a page, and bytes of its streams before they are deflated.
MAX_FRAMES = 1_000_000
MAX_BYTES = 1_000_000_000
# Pages that are larger open slowly [bytes].
LARGE = 64_000_000
TITLE = 120


@dataclass(frozen=True, slots=True)
class Page:
    """A page that is ready to be written.

    Attributes:
        manifest: What it shows.
        blocks: Its streams.
        notices: What is odd about its files.
    """

    manifest: dict[str, Any]
    blocks: list[str]
    notices: list[Fault] = field(default_factory=list)

    def parts(self, watch: dict[str, Any] | None = None) -> Iterable[bytes]:
        """Return its bytes, in parts; watch: whom to ask for changes, and the state."""
        manifest = self.manifest
        if watch is not None:
            manifest = manifest | {"watch": watch}
        return page_parts(manifest, self.blocks, watched=watch is not None)

    def html(self) -> str:
        """Return it as text."""
        return b"".join(self.parts()).decode("utf-8")


@dataclass(frozen=True, slots=True)
class PageReport:
    """A page that was written."""

    path: Path  # the file
    size: int  # of it [bytes]
    page: Page

    def as_dict(self) -> dict[str, Any]:
        """Return it as plain values for a JSON report."""
        manifest = self.page.manifest
        time, errors = manifest["time"], manifest["errors"]
        return {
            "preview": "animtool/1",
            "output": str(self.path),
            "bytes": self.size,
            "frames": time["count"],
            "first": time["first"],
            "step": time["step"],
            "fps": time["label"],
            **{
                name: len(manifest[name])
                for name in ("takes", "meshes", "curves3d", "points", "instances")
            },
            **{name: len(manifest[name]) for name in ("cameras", "channels")},
            "findings": len(manifest["findings"]),
            "rotation_error_deg": errors["rotation_deg"],
            "position_error_mm": errors["position_mm"],
            "not_shown": manifest["notices"],
            "notices": [notice.as_dict() for notice in self.page.notices],
        }


def write_page(
    files: Sequence[Path | str],
    output: Path,
    options: PreviewOptions | None = None,
    *,
    overwrite: bool = False,
) -> PageReport:
    """Write a page that shows files.

    Args:
        files: Any that animtool reads: takes, rigs, scenes, stages, markers.
        output: The page, ``.html``.
        options: What it shows.
        overwrite: Replace a page that exists.

    Raises:
        FormatError: A file cannot be read, or is malformed.
        OptionError: A file shows nothing (PRV001), the page is no ``.html`` (PRV002)
            or exists (OUT001), or it would be too large (PRV003).
        OutputError: The page cannot be written.
    """
    paths = [Path(file) for file in files]
    check_page_output(output, paths, overwrite=overwrite)
    with sparing_inputs([output]):
        page = make_page(paths, options)
    write_parts(output, page.parts())
    return PageReport(output, output.stat().st_size, page)


def check_page_output(output: Path, files: Sequence[Path], *, overwrite: bool) -> None:
    """Refuse a page that cannot or must not be written."""
    if output.suffix.lower() not in {".html", ".htm"}:
        message = f"a page is an .html file, and {output.name!r} is none"
        raise OptionError(Fault("PRV002", message, hint="name it -o page.html"))
    check_outputs([output], files, overwrite=overwrite)


def make_page(files: Sequence[Path], options: PreviewOptions | None = None) -> Page:
    """Return the page of files; see `write_page`."""
    options = options or PreviewOptions()
    with ExitStack() as held:
        opened = [open_file(path, options, files, held) for path in files]
        draft, notices = _drafted(opened, options)
    if options.findings:
        _add_findings(draft, files)
    names = [path.name for path in files]
    return _page(draft, names, opened, notices)


def make_take_page(name: str, stream: TakeStream) -> Page:
    """Return the page of a take in memory."""
    from animtool.preview.opened import own_take

    opened = OpenFile(Path(name), "m", stream.rig.up, [own_take(name, stream)])
    draft, notices = _drafted([opened], PreviewOptions())
    return _page(draft, [name], [opened], notices)


def _page(
    draft: Draft, names: list[str], opened: list[OpenFile], notices: list[Fault]
) -> Page:
    title = ", ".join(names)
    source = {
        "files": names,
        "unit": opened[0].unit,
        "up": str(opened[0].up).lower(),
    }
    if draft.packer.nbytes > MAX_BYTES:
        size = draft.packer.nbytes / 1e6
        message = f"the page would hold {size:.0f} MB of frames"
        raise OptionError(Fault("PRV003", message, hint=_FEWER))
    manifest, blocks = draft.manifest(
        title if len(title) <= TITLE else title[: TITLE - 1] + "…", source
    )
    size = sum(map(len, blocks))
    if size > LARGE:
        message = f"the page has {size / 1e6:.0f} MB, which browsers open slowly"
        notices.append(Fault("PRV102", message, hint=_FEWER, severity=Severity.WARNING))
    return Page(manifest, blocks, notices)


_FEWER = "--frames 1-240x2 shows fewer frames, --prim-path a part of a stage"


@dataclass(slots=True)
class _Part:
    """A take, read, with where it is on the timeline."""

    file: int
    take: OpenTake
    stream: TakeStream
    gathered: Gathered
    first: Fraction  # frame of the page that its first one is
    origin: Fraction  # the same of its file's first frame, which may be left out
    shifted: bool = False  # whether it is shown at other frames than its own

    @property
    def last(self) -> Fraction:
        return self.first + max(0, self.gathered.frames - 1) * self.stream.step


def _drafted(
    opened: list[OpenFile], options: PreviewOptions
) -> tuple[Draft, list[Fault]]:
    notices = [file.located(notice) for file in opened for notice in file.notices]
    fps = next((rate for file in opened if (rate := file.fps)), Fraction(24))
    parts = [
        _gathered(number, file, take, fps, options, notices)
        for number, file in enumerate(opened)
        for take in file.takes
    ]
    notices += _aligned(parts)
    timeline = _timeline(opened, parts, fps, options)
    draft = Draft(timeline)
    shown = [(part, _add_part(draft, part)) for part in parts]
    for part, one in shown:
        add_character(draft, part.take, one)
        add_channels(draft, one, part.take.clip, part.origin)
    for file in opened:
        if file.contents is not None:
            from animtool.preview.stage import add_stage

            add_stage(draft, file.contents)
        if file.markers is not None:
            _add_markers(draft, file.path.name, file.markers)
    return draft, notices


def _gathered(
    number: int,
    file: OpenFile,
    take: OpenTake,
    fps: Fraction,
    options: PreviewOptions,
    notices: list[Fault],
) -> _Part:
    stream = take.stream
    start = Fraction(1)
    if stream.start is not None:
        start = frame_start(stream.start, stream.fps, fps, whole=True)
    origin = start
    # A rig at rest is of any frame and rate.
    rests = is_named(file.path, "rig")
    asked = None if rests or (stream.fps == fps and stream.step == 1) else fps
    chosen = None if rests else options.frame_range
    uneven = stream.step != 1 or start.denominator != 1
    quiet = {"SCN202"}
    if chosen is None and uneven and (span := _stated(file, fps)) is not None:
        quiet = {"SCN202", "TAKE008"}
        # Samples of any times, at the frames of their stage.
        chosen = FrameRange(math.ceil(span[0]), math.floor(span[1]))
        asked = None if stream.fps == fps else fps
    if asked is not None or chosen is not None:
        bake = BakeOptions(fps=asked, frame_range=chosen)
        said: list[Fault] = []
        stream = in_frames(stream, bake, start, file.path, said)
        # It may last as long as it does.
        notices += [one for one in said if one.code not in quiet]
        start = Fraction(1) if stream.start is None else stream.start
    if asked is not None and take.stream.fps != fps:
        message = f"has {rate_label(take.stream.fps)} and is shown at {rate_label(fps)}"
        note = Fault("PRV103", message, str(file.path), severity=Severity.NOTE)
        notices.append(note)
    gathered = Gathered(stream.blocks)
    notices += map(file.located, stream.notices)
    return _Part(number, take, stream, gathered, start, origin)


def _aligned(parts: list[_Part]) -> list[Fault]:
    """Bring takes that share no frame with the first to its start; say of which."""
    notices = []
    for part in parts[1:]:
        lead = parts[0]
        if part.first > lead.last or part.last < lead.first:
            message = (
                f"take {part.take.name!r} begins at frame {frame_label(part.first)}, "
                f"and is shown from frame {frame_label(lead.first)}"
            )
            notices.append(Fault("PRV104", message, severity=Severity.NOTE))
            part.origin += lead.first - part.first
            part.first, part.shifted = lead.first, True
    return notices


def _timeline(
    opened: Sequence[OpenFile],
    parts: Sequence[_Part],
    fps: Fraction,
    options: PreviewOptions,
) -> Timeline:
    spans = [
        _within(part, _stated(opened[part.file], fps))
        for part in parts
        if part.gathered.frames > 1
    ]
    step = Fraction(1)
    for file in opened:
        if file.contents is not None and (found := _moving_span(file.contents)):
            ratio = fps / file.contents.fps
            spans.append((found[0] * ratio, found[1] * ratio))
        if file.markers is not None:
            clock = file.markers.clock
            ratio = fps / clock.fps
            last = clock.start + (clock.count - 1) * clock.step
            spans.append((clock.start * ratio, last * ratio))
    first = min((a for a, _ in spans), default=parts[0].first if parts else Fraction(1))
    last = max((b for _, b in spans), default=first)
    frames = options.frame_range
    if frames is not None:
        start, end = first, last
        last = min(last, Fraction(frames.last))
        first, step = max(first, Fraction(frames.first)), Fraction(frames.step)
        if last < first:
            message = (
                f"frames {frames.first}-{frames.last} are not in the file, which has "
                f"{frame_label(start)}-{frame_label(end)}"
            )
            raise OptionError(Fault("CLI005", message))
    count = int((last - first) / step) + 1
    if count > MAX_FRAMES:
        message = f"the page would have {count} frames; at most {MAX_FRAMES} are shown"
        raise OptionError(Fault("PRV003", message, hint=_FEWER))
    return Timeline(fps, first, step, count)


def _within(
    part: _Part, stated: tuple[Fraction, Fraction] | None
) -> tuple[Fraction, Fraction]:
    """Return the frames of a take, without those that its stage does not count."""
    if stated is None or part.shifted:
        return part.first, part.last
    first, last = max(part.first, stated[0]), min(part.last, stated[1])
    return (first, last) if first <= last else (part.first, part.last)


def _stated(file: OpenFile, fps: Fraction) -> tuple[Fraction, Fraction] | None:
    """Return the frames that a stage states; None of other files."""
    contents = file.contents
    span = None if contents is None else contents.stated_span
    if contents is None or span is None:
        return None
    ratio = fps / contents.fps
    return span[0] * ratio, span[1] * ratio


def _moving_span(contents: StageContents) -> tuple[Fraction, Fraction] | None:
    moving = any(prim.deforms or prim.travels for prim in contents.prims)
    return contents.span if moving or contents.cameras() else None


def _add_part(draft: Draft, part: _Part) -> Shown:
    first = draft.timeline.index(part.first)
    shown = add_take(draft, part.take.name, part.stream, part.gathered, first)
    shown.entry["file"] = part.file
    return shown


def _add_markers(draft: Draft, name: str, markers: Markers) -> None:
    """Add markers to a page, at the frames nearest to its own."""
    clock = markers.clock
    ratio = float(clock.fps / draft.timeline.fps)
    places = (draft.timeline.codes * ratio - float(clock.start)) / float(clock.step)
    frames = np.clip(np.rint(places), 0, clock.count - 1).astype(np.int64)
    positions = markers.positions[frames]
    turn = up_from_up(UpAxis.Y, markers.up)
    if turn is not None:
        positions = so3.rotate(np.array(turn), positions)
    stored = quantized_range(positions.reshape(len(frames), -1), period=3)
    draft.off(position=stored.error)
    draft.points.append(
        {
            "name": name,
            "positions": draft.packer.add(stored),
            "radius": 0.0,
            "radii": None,
            "color": None,
            "colors": None,
            "names": list(markers.names),
        }
    )


def _add_findings(draft: Draft, files: Sequence[Path]) -> None:
    faults = ordered(find_faults(files))
    takes: dict[str, tuple[int, Sequence[str]]] = {}
    for number, entry in enumerate(draft.takes):
        path = str(files[entry["file"]])
        takes.setdefault(path, (number, entry["skeleton"]["names"]))
    draft.findings += [finding_entry(fault, takes) for fault in faults[:MAX_FINDINGS]]
    if len(faults) > MAX_FINDINGS:
        more = counted(len(faults) - MAX_FINDINGS, "finding")
        draft.note(f"{more} more: animtool validate lists them")
