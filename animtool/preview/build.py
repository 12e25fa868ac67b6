"""Builds pages: reads files, puts them on one timeline, writes one HTML file."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import ExitStack
from dataclasses import field
from fractions import Fraction
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from animtool.core.errors import Fault, OptionError, Severity, counted
from animtool.core.files.output import check_outputs, protect_inputs, write_parts
from animtool.core.record import dataclass
from animtool.core.shot import FrameList
from animtool.core.units import UpAxis, up_from_up
from animtool.maths import so3
from animtool.motion.markers import Markers
from animtool.motion.take import TakeStream
from animtool.preview.channels import add_channels
from animtool.preview.draft import PageDraft
from animtool.preview.findings import (
    MAX_FINDINGS,
    find_faults,
    finding_entry,
    ordered,
)
from animtool.preview.meshes import add_character
from animtool.preview.open_file import OpenFile, open_file
from animtool.preview.options import PreviewOptions
from animtool.preview.page import page_parts
from animtool.preview.pictures.kinds import PAGE_SUFFIXES
from animtool.preview.streams import quantized_range
from animtool.preview.takes import ShownMotion, add_take
from animtool.preview.timing import FEWER, TimedPart, align, gathered_part, timeline_of
from animtool.preview.visibility import add_visibility

# Bytes of its streams before they are deflated.
MAX_BYTES = 1_000_000_000
# Pages that are larger open slowly [bytes].
LARGE = 64_000_000
TITLE = 120


@dataclass(frozen=True, slots=True)
class PreviewPage:
    """A page ready to be written.

    Attributes:
        manifest: What it shows.
        blocks: Its streams.
        notices: What is odd about its files.
    """

    manifest: dict[str, Any]
    blocks: list[str]
    notices: list[Fault] = field(default_factory=list)

    def parts(self, watch: dict[str, Any] | None = None) -> Iterable[bytes]:
        """Yield its bytes in parts; watch: server to poll for changes, and state."""
        manifest = self.manifest
        if watch is not None:
            manifest = manifest | {"watch": watch}
        return page_parts(manifest, self.blocks, watched=watch is not None)

    def html(self) -> str:
        """Return the page as text."""
        return b"".join(self.parts()).decode("utf-8")


@dataclass(frozen=True, slots=True)
class PageReport:
    """Report on a written page."""

    path: Path  # the file
    size: int  # of it [bytes]
    page: PreviewPage

    json_keys: ClassVar[str] = (
        "'preview' output=path bytes=size frames=page.manifest.time.count "
        "first=page.manifest.time.first step=page.manifest.time.step "
        "fps=page.manifest.time.label *counts "
        "rotation_error_deg=page.manifest.errors.rotation_deg "
        "position_error_mm=page.manifest.errors.position_mm "
        "not_shown=page.manifest.notices notices=page.notices"
    )

    @property
    def codes(self) -> list[str]:
        """Codes of the findings on the page."""
        findings = self.page.manifest["findings"]
        return list(dict.fromkeys(finding["code"] for finding in findings))

    @property
    def counts(self) -> dict[str, int]:
        """Number of items of each kind on the page."""
        manifest = self.page.manifest
        shapes = ("takes", "meshes", "curves3d", "points", "instances")
        kinds = (*shapes, "cameras", "channels", "findings")
        return {name: len(manifest[name]) for name in kinds}


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
    if options is not None and isinstance(options.frame_range, FrameList):
        message = "a page plays a range of frames"
        hint = "1-240x2 plays every second frame; .png and .webp show listed ones"
        raise OptionError(Fault("PRV006", message, hint=hint, where="frames"))
    with protect_inputs([output]):
        page = make_page(paths, options)
    write_parts(output, page.parts())
    return PageReport(output, output.stat().st_size, page)


def check_page_output(output: Path, files: Sequence[Path], *, overwrite: bool) -> None:
    """Refuse an output path that cannot or must not be written."""
    if output.suffix.lower() not in PAGE_SUFFIXES:
        message = f"a page is an .html file, but the name is {output.name!r}"
        raise OptionError(
            Fault("PRV002", message, hint="name it page.html, for example")
        )
    check_outputs([output], files, overwrite=overwrite)


def make_page(
    files: Sequence[Path], options: PreviewOptions | None = None
) -> PreviewPage:
    """Return the page of files; see `write_page`."""
    options = options or PreviewOptions()
    with ExitStack() as context:
        opened = [open_file(path, options, files, context) for path in files]
        draft, notices = _drafted(opened, options)
    if options.findings:
        _add_findings(draft, files)
    names = [path.name for path in files]
    return _page(draft, names, opened, notices)


def make_take_page(name: str, stream: TakeStream) -> PreviewPage:
    """Return the page of a take in memory."""
    from animtool.preview.open_file import take_of_stream

    opened = OpenFile(Path(name), "m", stream.rig.up, [take_of_stream(name, stream)])
    draft, notices = _drafted([opened], PreviewOptions())
    return _page(draft, [name], [opened], notices)


def _page(
    draft: PageDraft, names: list[str], opened: list[OpenFile], notices: list[Fault]
) -> PreviewPage:
    title = ", ".join(names)
    source = {
        "files": names,
        "unit": opened[0].unit,
        "up": str(opened[0].up).lower(),
    }
    if draft.packer.nbytes > MAX_BYTES:
        size = draft.packer.nbytes / 1e6
        message = f"the page would hold {size:.0f} MB of frames"
        raise OptionError(Fault("PRV003", message, hint=FEWER))
    manifest, blocks = draft.manifest(
        title if len(title) <= TITLE else title[: TITLE - 1] + "…", source
    )
    size = sum(map(len, blocks))
    if size > LARGE:
        message = f"the page has {size / 1e6:.0f} MB, which browsers open slowly"
        notices.append(Fault("PRV102", message, hint=FEWER, severity=Severity.WARNING))
    return PreviewPage(manifest, blocks, notices)


def _drafted(
    opened: list[OpenFile], options: PreviewOptions
) -> tuple[PageDraft, list[Fault]]:
    notices = [file.located(notice) for file in opened for notice in file.notices]
    fps = next((rate for file in opened if (rate := file.fps)), Fraction(24))
    parts = [
        gathered_part(number, file, take, fps, options, notices)
        for number, file in enumerate(opened)
        for take in file.takes
    ]
    notices += align(parts)
    timeline = timeline_of(opened, parts, fps, options)
    draft = PageDraft(timeline)
    shown = [(part, _add_part(draft, part)) for part in parts]
    for part, one in shown:
        add_character(draft, part.take, one)
        add_visibility(draft, opened[part.file], part, one)
        add_channels(draft, one, part.take.clip, part.origin)
    for file in opened:
        if file.contents is not None:
            from animtool.preview.stage import add_stage

            add_stage(draft, file.contents)
        if file.markers is not None:
            _add_markers(draft, file.path.name, file.markers)
        if file.targets is not None:
            from animtool.preview.targets import add_targets

            # Those of the first take, of which the others may be versions.
            up = opened[shown[0][0].file].up if shown else UpAxis.Y
            add_targets(draft, file.targets, shown[0][1] if shown else None, up)
    return draft, notices


def _add_part(draft: PageDraft, part: TimedPart) -> ShownMotion:
    first = draft.timeline.index(part.first)
    shown = add_take(draft, part.take.name, part.stream, part.gathered, first)
    shown.entry["file"] = part.file
    return shown


def _add_markers(draft: PageDraft, name: str, markers: Markers) -> None:
    """Add markers to a page, sampled at the nearest frames."""
    clock = markers.clock
    ratio = float(clock.fps / draft.timeline.fps)
    positions_at = (draft.timeline.codes * ratio - float(clock.start)) / float(
        clock.step
    )
    frames = np.clip(np.rint(positions_at), 0, clock.count - 1).astype(np.int64)
    positions = markers.positions[frames]
    up_rotation = up_from_up(UpAxis.Y, markers.up)
    if up_rotation is not None:
        positions = so3.rotate(np.array(up_rotation), positions)
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


def _add_findings(draft: PageDraft, files: Sequence[Path]) -> None:
    faults = ordered(find_faults(files))
    takes: dict[str, tuple[int, Sequence[str]]] = {}
    for number, entry in enumerate(draft.takes):
        path = str(files[entry["file"]])
        takes.setdefault(path, (number, entry["skeleton"]["names"]))
    draft.findings += [finding_entry(fault, takes) for fault in faults[:MAX_FINDINGS]]
    if len(faults) > MAX_FINDINGS:
        more = counted(len(faults) - MAX_FINDINGS, "finding")
        draft.note(f"{more} more: animtool validate lists them")
