"""Builds pages: reads files, aligns them on one timeline and writes one HTML file."""

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
    errors_first,
    find_faults,
    finding_entry,
)
from animtool.preview.meshes import add_character
from animtool.preview.open_file import OpenFile, open_file
from animtool.preview.options import PreviewOptions
from animtool.preview.page import page_parts
from animtool.preview.pictures.kinds import PAGE_SUFFIXES
from animtool.preview.takes import PageTake, add_take
from animtool.preview.timing import (
    FEWER_FRAMES_HINT,
    TimelineTake,
    align_takes,
    fit_to_page,
    timeline_of,
)
from animtool.preview.visibility import add_visibility

# Limit of a page's streams before compression [byte].
MAX_BYTES = 1_000_000_000
# Larger pages get a warning: browsers open them slowly [byte].
LARGE_PAGE = 64_000_000
MAX_TITLE = 120


@dataclass(frozen=True, slots=True)
class PreviewPage:
    """A page that is ready to be written.

    Attributes:
        manifest: Description of the contents, for the viewer.
        blocks: Compressed streams, as text.
        notices: Warnings and notes about its files.
    """

    manifest: dict[str, Any]
    blocks: list[str]
    notices: list[Fault] = field(default_factory=list)

    def chunks(self, watch: dict[str, Any] | None = None) -> Iterable[bytes]:
        """Yield the page in chunks of bytes.

        Args:
            watch: Server to poll for changes, and the state of the page; None for a
                static page.
        """
        manifest = self.manifest
        if watch is not None:
            manifest = manifest | {"watch": watch}
        return page_parts(manifest, self.blocks, watched=watch is not None)

    def html(self) -> str:
        """Return the page as text."""
        return b"".join(self.chunks()).decode("utf-8")


@dataclass(frozen=True, slots=True)
class PageReport:
    """Report on a written page."""

    path: Path
    size: int  # size of the file [byte]
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
        files: Files of any supported kind: takes, rigs, scenes, stages, markers.
        output: Path of the page, ``.html``.
        options: What the page shows.
        overwrite: Replace an existing page.
    """
    paths = [Path(file) for file in files]
    check_page_output(output, paths, overwrite=overwrite)
    if options is not None and isinstance(options.frame_range, FrameList):
        message = "a page plays a range of frames"
        hint = "1-240x2 plays every second frame; .png and .webp show listed ones"
        raise OptionError(Fault("PRV006", message, hint=hint, where="frames"))
    with protect_inputs([output]):
        page = make_page(paths, options)
    write_parts(output, page.chunks())
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
        open_files = [open_file(path, options, files, context) for path in files]
        draft, notices = _collect_contents(open_files, options)
    if options.findings:
        _add_findings(draft, files)
    names = [path.name for path in files]
    return _build_page(draft, names, open_files, notices)


def make_take_page(name: str, stream: TakeStream) -> PreviewPage:
    """Return the page of a take in memory."""
    from animtool.preview.open_file import take_of_stream

    file = OpenFile(Path(name), "m", stream.rig.up, [take_of_stream(name, stream)])
    draft, notices = _collect_contents([file], PreviewOptions())
    return _build_page(draft, [name], [file], notices)


def _build_page(
    draft: PageDraft, names: list[str], files: list[OpenFile], notices: list[Fault]
) -> PreviewPage:
    """Return the page of a draft; refuse a page that is too large."""
    title = ", ".join(names)
    source = {
        "files": names,
        "unit": files[0].unit,
        "up": str(files[0].up).lower(),
    }
    if draft.packer.total_bytes > MAX_BYTES:
        size = draft.packer.total_bytes / 1e6
        message = f"the page would hold {size:.0f} MB of frames"
        raise OptionError(Fault("PRV003", message, hint=FEWER_FRAMES_HINT))
    manifest, blocks = draft.manifest(
        title if len(title) <= MAX_TITLE else title[: MAX_TITLE - 1] + "…", source
    )
    size = sum(map(len, blocks))
    if size > LARGE_PAGE:
        message = f"the page has {size / 1e6:.0f} MB, which browsers open slowly"
        notices.append(
            Fault("PRV102", message, hint=FEWER_FRAMES_HINT, severity=Severity.WARNING)
        )
    return PreviewPage(manifest, blocks, notices)


def _collect_contents(
    files: list[OpenFile], options: PreviewOptions
) -> tuple[PageDraft, list[Fault]]:
    """Read files into a draft on one timeline; return it with notices."""
    notices = [file.at_scene(notice) for file in files for notice in file.notices]
    fps = next((rate for file in files if (rate := file.fps)), Fraction(24))
    timeline_takes = [
        fit_to_page(number, file, take, fps, options, notices)
        for number, file in enumerate(files)
        for take in file.takes
    ]
    notices += align_takes(timeline_takes)
    timeline = timeline_of(files, timeline_takes, fps, options)
    draft = PageDraft(timeline)
    page_takes = [
        (timeline_take, _add_timeline_take(draft, timeline_take))
        for timeline_take in timeline_takes
    ]
    for timeline_take, page_take in page_takes:
        add_character(draft, timeline_take.take, page_take)
        add_visibility(draft, files[timeline_take.file_index], timeline_take, page_take)
        add_channels(
            draft, page_take, timeline_take.take.clip, timeline_take.clip_origin
        )
    for file in files:
        if file.contents is not None:
            from animtool.preview.stage import add_stage

            add_stage(draft, file.contents)
        if file.markers is not None:
            _add_markers(draft, file.path.name, file.markers)
        if file.targets is not None:
            from animtool.preview.targets import add_targets

            # Targets apply to the first take; other takes may be versions of it.
            up = files[page_takes[0][0].file_index].up if page_takes else UpAxis.Y
            add_targets(
                draft, file.targets, page_takes[0][1] if page_takes else None, up
            )
    return draft, notices


def _add_timeline_take(draft: PageDraft, timeline_take: TimelineTake) -> PageTake:
    """Add a take with its meshes, visibility and curves; return it as stored."""
    first = draft.timeline.index(timeline_take.first_frame)
    page_take = add_take(
        draft,
        timeline_take.take.name,
        timeline_take.stream,
        timeline_take.motion,
        first,
    )
    page_take.entry["file"] = timeline_take.file_index
    return page_take


def _add_markers(draft: PageDraft, name: str, markers: Markers) -> None:
    """Add markers to a page, sampled at the nearest frames."""
    clock = markers.clock
    ratio = float(clock.fps / draft.timeline.fps)
    frame_positions = (draft.timeline.codes * ratio - float(clock.start)) / float(
        clock.step
    )
    frames = np.clip(np.rint(frame_positions), 0, clock.count - 1).astype(np.int64)
    positions = markers.positions[frames]
    up_rotation = up_from_up(UpAxis.Y, markers.up)
    if up_rotation is not None:
        positions = so3.rotate(np.array(up_rotation), positions)
    draft.points.append(
        {
            "name": name,
            "positions": draft.add_positions(positions),
            "radius": 0.0,
            "radii": None,
            "color": None,
            "colors": None,
            "names": list(markers.names),
        }
    )


def _add_findings(draft: PageDraft, files: Sequence[Path]) -> None:
    """Add the findings of `validate`, each linked to the takes it concerns."""
    faults = errors_first(find_faults(files))
    takes: dict[str, tuple[int, Sequence[str]]] = {}
    for number, entry in enumerate(draft.takes):
        path = str(files[entry["file"]])
        takes.setdefault(path, (number, entry["skeleton"]["names"]))
    draft.findings += [finding_entry(fault, takes) for fault in faults[:MAX_FINDINGS]]
    if len(faults) > MAX_FINDINGS:
        omitted_text = counted(len(faults) - MAX_FINDINGS, "finding")
        draft.add_notice(f"{omitted_text} more: animtool validate lists them")
