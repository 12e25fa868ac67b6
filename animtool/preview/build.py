"""Builds pages: reads files, aligns them on one timeline and writes one HTML file."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import field
from fractions import Fraction
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from animtool.core.clock import time_codes
from animtool.core.errors import AnimtoolError, Fault, OptionError, Severity, counted
from animtool.core.files.output import check_outputs, protect_inputs, write_parts
from animtool.core.loaded import path_list
from animtool.core.record import dataclass
from animtool.core.shot import FrameList
from animtool.core.units import UpAxis, up_from_up
from animtool.maths import so3
from animtool.motion.markers import Markers
from animtool.motion.take import TakeStream
from animtool.preview.channels import add_channels
from animtool.preview.draft import PageDraft
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

# Limit of a page's streams before compression [byte].
MAX_STREAM_BYTES = 1_000_000_000
# Larger pages get a warning: browsers open them slowly [byte].
LARGE_PAGE_BYTES = 64_000_000
MAX_TITLE_LENGTH = 120
# Maximum number of findings listed on a page; the others are only counted.
MAX_FINDINGS = 500
_QUOTED_TEXT_PATTERN = re.compile(r"'((?:[^'\\]|\\.)*)'|\"((?:[^\"\\]|\\.)*)\"")


@dataclass(frozen=True, slots=True)
class PreviewPage:
    """Manifest, data blocks and notices of a page that is ready to be written.

    Attributes:
        manifest: Description of the contents, for the viewer.
        blocks: Compressed streams, as text.
        notices: Warnings and notes about its files.
    """

    manifest: dict[str, Any]
    blocks: list[str]
    notices: list[Fault] = field(default_factory=list)

    def chunks(self, watch: dict[str, Any] | None = None) -> Iterable[bytes]:
        """Yield the page as UTF-8 HTML in chunks of bytes.

        Args:
            watch: Server to poll for changes, and the state of the page; None for a
                static page.
        """
        manifest = self.manifest
        if watch is not None:
            manifest = manifest | {"watch": watch}
        return page_parts(manifest, self.blocks, is_watched=watch is not None)

    def html(self) -> str:
        """Return the complete page as one HTML text."""
        return b"".join(self.chunks()).decode("utf-8")


@dataclass(frozen=True, slots=True)
class PageReport:
    """Path, size and contents of a page that was written."""

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
        """Distinct rule codes of the findings on the page."""
        findings = self.page.manifest["findings"]
        return list(dict.fromkeys(finding["code"] for finding in findings))

    @property
    def counts(self) -> dict[str, int]:
        """Number of items of each kind on the page."""
        manifest = self.page.manifest
        drawn_kinds = ("takes", "meshes", "curves3d", "points", "instances")
        kinds = (*drawn_kinds, "cameras", "channels", "findings")
        return {name: len(manifest[name]) for name in kinds}


def write_page(
    files: Path | str | Sequence[Path | str],
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
    paths = path_list(files, "files")
    check_page_output(output, paths, overwrite=overwrite)
    if options is not None and isinstance(options.frame_range, FrameList):
        message = "a page plays a range of frames"
        hint = "1-240x2 plays every second frame; .png and .webp show listed ones"
        raise OptionError(Fault("PRV006", message, hint=hint, where="frame_range"))
    with protect_inputs([output]):
        page = make_page(paths, options)
    write_parts(output, page.chunks())
    return PageReport(output, output.stat().st_size, page)


def check_page_output(output: Path, files: Sequence[Path], *, overwrite: bool) -> None:
    """Raise an error if the output path is not a page or must not be overwritten."""
    if output.suffix.lower() not in PAGE_SUFFIXES:
        message = f"a page is an .html file, but the name is {output.name!r}"
        raise OptionError(
            Fault("PRV002", message, hint="name it page.html, for example")
        )
    check_outputs([output], files, overwrite=overwrite)


def make_page(
    files: Sequence[Path], options: PreviewOptions | None = None
) -> PreviewPage:
    """Return a page that shows files; see `write_page`."""
    options = options or PreviewOptions()
    with ExitStack() as context:
        open_files = [open_file(path, options, files, context) for path in files]
        draft, notices = _collect_contents(open_files, options)
    if options.findings:
        _add_findings(draft, files)
    file_names = [path.name for path in files]
    return _build_page(draft, file_names, open_files, notices)


def make_take_page(name: str, stream: TakeStream) -> PreviewPage:
    """Return a page that shows a take in memory."""
    from animtool.preview.open_file import take_of_stream

    file = OpenFile(Path(name), "m", stream.rig.up, [take_of_stream(name, stream)])
    draft, notices = _collect_contents([file], PreviewOptions())
    return _build_page(draft, [name], [file], notices)


def _build_page(
    draft: PageDraft, file_names: list[str], files: list[OpenFile], notices: list[Fault]
) -> PreviewPage:
    """Return the finished page of a draft; raise an error if it is too large."""
    title = ", ".join(file_names)
    source_entry = {
        "files": file_names,
        "unit": files[0].unit,
        "up": str(files[0].up).lower(),
    }
    if draft.packer.total_bytes > MAX_STREAM_BYTES:
        megabytes = draft.packer.total_bytes / 1e6
        message = f"the page would hold {megabytes:.0f} MB of frames"
        raise OptionError(Fault("PRV003", message, hint=FEWER_FRAMES_HINT))
    manifest, blocks = draft.finish(
        title
        if len(title) <= MAX_TITLE_LENGTH
        else title[: MAX_TITLE_LENGTH - 1] + "…",
        source_entry,
    )
    size = sum(map(len, blocks))
    if size > LARGE_PAGE_BYTES:
        message = f"the page has {size / 1e6:.0f} MB, which browsers open slowly"
        notices.append(
            Fault("PRV102", message, hint=FEWER_FRAMES_HINT, severity=Severity.WARNING)
        )
    return PreviewPage(manifest, blocks, notices)


def _collect_contents(
    files: list[OpenFile], options: PreviewOptions
) -> tuple[PageDraft, list[Fault]]:
    """Return a draft with the contents of all files on one timeline, and notices."""
    notices = [
        file.relocated_to_scene(notice) for file in files for notice in file.notices
    ]
    fps = next((rate for file in files if (rate := file.fps)), Fraction(24))
    timeline_takes = [
        fit_to_page(file_index, file, take, fps, options, notices)
        for file_index, file in enumerate(files)
        for take in file.takes
    ]
    notices += align_takes(timeline_takes)
    timeline = timeline_of(files, timeline_takes, fps, options, notices)
    draft = PageDraft(timeline)
    page_takes = [
        (timeline_take, _add_timeline_take(draft, timeline_take))
        for timeline_take in timeline_takes
    ]
    for timeline_take, page_take in page_takes:
        add_character(draft, timeline_take.take, page_take)
        _add_visibility(
            draft, files[timeline_take.file_index], timeline_take, page_take
        )
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
    """Add a take on the timeline to a page; return it as stored on the page."""
    first_sample = draft.timeline.index(timeline_take.first_frame)
    page_take = add_take(
        draft,
        timeline_take.take.name,
        timeline_take.stream,
        timeline_take.motion,
        first_sample,
    )
    page_take.entry["file"] = timeline_take.file_index
    return page_take


def _add_visibility(
    draft: PageDraft, file: OpenFile, timeline_take: TimelineTake, page_take: PageTake
) -> None:
    """Add the frames in which a take and its meshes are visible.

    Args:
        draft: The page, with the take and its meshes.
        file: The file of the take.
        timeline_take: The take on the timeline.
        page_take: The take on the page.
    """
    contents, prim = file.contents, timeline_take.take.prim
    if contents is None or not prim:
        return
    codes = time_codes(
        timeline_take.first_frame - timeline_take.shift,
        timeline_take.stream.step,
        page_take.frames,
    )
    codes = codes * float(contents.fps / draft.timeline.fps)
    is_visible = contents.visibility(prim, codes)
    page_take.entry["visible"] = draft.add_mask(is_visible)
    if not is_visible.any():
        draft.add_notice(
            f"{timeline_take.take.name!r} is hidden in every frame: it is not drawn"
        )
    meshes = [mesh for mesh in draft.meshes if mesh["take"] == page_take.index]
    visibility_by_mesh = contents.mesh_visibility(prim, codes) if meshes else {}
    for mesh in meshes:
        is_mesh_visible = visibility_by_mesh.get(mesh["name"], is_visible)
        if not np.array_equal(is_mesh_visible, is_visible):
            mesh["visible"] = draft.add_mask(is_mesh_visible)


def _add_markers(draft: PageDraft, set_name: str, markers: Markers) -> None:
    """Add markers to a page, sampled at the nearest frames."""
    clock = markers.clock
    rate_ratio = float(clock.fps / draft.timeline.fps)
    frame_positions = (draft.timeline.codes * rate_ratio - float(clock.start)) / float(
        clock.step
    )
    frames = np.clip(np.rint(frame_positions), 0, clock.count - 1).astype(np.int64)
    positions = markers.positions[frames]
    up_rotation = up_from_up(UpAxis.Y, markers.up)
    if up_rotation is not None:
        positions = so3.rotate(np.array(up_rotation), positions)
    draft.add_points(
        set_name, draft.add_positions(positions), names=list(markers.names)
    )


def _add_findings(draft: PageDraft, files: Sequence[Path]) -> None:
    """Add the distinct findings of `validate`, errors first, linked to their takes."""
    severities = [Severity.ERROR, Severity.WARNING, Severity.NOTE]
    faults = sorted(
        dict.fromkeys(_find_faults(files)),
        key=lambda fault: severities.index(fault.severity),
    )
    takes_by_path: dict[str, tuple[int, Sequence[str]]] = {}
    for take_index, take_entry in enumerate(draft.takes):
        path = str(files[take_entry["file"]])
        takes_by_path.setdefault(path, (take_index, take_entry["skeleton"]["names"]))
    draft.findings += [
        _finding_entry(fault, takes_by_path) for fault in faults[:MAX_FINDINGS]
    ]
    if len(faults) > MAX_FINDINGS:
        omitted_findings = counted(len(faults) - MAX_FINDINGS, "finding")
        draft.add_notice(f"{omitted_findings} more: animtool validate lists them")


def _find_faults(files: Sequence[Path]) -> list[Fault]:
    """Return the findings of `validate` in files, skipping files it cannot check."""
    from animtool.validation.options import ValidateOptions
    from animtool.validation.run import validate_files

    faults: list[Fault] = []
    for path in files:
        try:
            report = validate_files([path], ValidateOptions(jobs=1))
        except AnimtoolError:
            continue
        faults += report.findings
    return faults


def _finding_entry(
    fault: Fault, takes_by_path: Mapping[str, tuple[int, Sequence[str]]]
) -> dict[str, Any]:
    """Return the entry of a finding in the page manifest.

    ``takes_by_path`` maps the path of a file to the index of its take and the names of
    its joints.
    """
    take_index, joint_names = takes_by_path.get(fault.path or "", (None, ()))
    joint = fault.joint
    if joint is None:
        # Rules quote the joints concerned in their messages.
        matches = _QUOTED_TEXT_PATTERN.findall(fault.message)
        quoted_texts = [single or double for single, double in matches]
        joint = next((name for name in quoted_texts if name in set(joint_names)), None)
    hint = f"; {fault.hint}" if fault.hint else ""
    return {
        "code": fault.code,
        "severity": str(fault.severity),
        "message": f"{fault.message}{hint}",
        "frame": fault.frame,
        "joint": joint,
        "take": take_index,
    }
