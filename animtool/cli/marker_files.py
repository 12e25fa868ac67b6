"""Options and messages that the marker commands share."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import click

from animtool.cli.console import Console
from animtool.cli.options import (
    output_option,
    read_source_options,
    source_options,
    stack_options,
    strict_option,
)
from animtool.cli.outputs import atomic_command, writing_options
from animtool.core.errors import Fault
from animtool.core.record import dataclass
from animtool.core.values import VERSION
from animtool.report.text import Template

if TYPE_CHECKING:
    from animtool.motion.markers import Markers

marker_options = stack_options(
    source_options,
    click.option(
        "--subject",
        metavar="NAME",
        help="Subject of the markers: the prefix of names such as Anna:LFHD.  "
        "[default: the only one]",
    ),
    strict_option,
    writing_options,
)
marker_output_option = output_option(
    "File to write: .c3d, .trc or .npz.", required=True
)


@dataclass(frozen=True, slots=True)
class WrittenMarkers:
    """Report of a written marker file."""

    command: str
    output: Path
    markers: Markers
    report: object  # report of the operation
    notices: list[Fault]
    json_keys: ClassVar[str] = "*head output *report notices"

    @property
    def head(self) -> dict[str, str]:
        """Command and version of the report."""
        return {self.command: VERSION}


MARKERS_TEMPLATE = Template(
    "animtool.cli.marker_files:WrittenMarkers",
    ("{output}: {markers:counts_of}",),
    {"counts_of": lambda markers: f"{markers!r}"[1:-1].removeprefix("Markers: ")},
)


def read_marker_file(path: Path, params: Mapping[str, Any]) -> Any:
    """Read a marker file with the source options of a command."""
    from animtool.formats.marker_files import open_markers

    options = read_source_options(params)
    return open_markers(
        path,
        unit=options.unit,
        up=options.up,
        fps=options.fps,
        subject=params.get("subject"),
    )


def run_on_markers(
    console: Console,
    command: str,
    sources: tuple[Path, ...],
    output: Path,
    params: Mapping[str, Any],
    process_markers: Callable[..., tuple[Any, Any]],
    template: Template | None = None,
) -> None:
    """Read marker files, process them, write the result and print a report.

    process_markers: Maps the markers of the sources to markers and a report with
        notices.
    """
    from animtool.cli.outputs import skip_existing_outputs
    from animtool.core.errors import refuse_warnings
    from animtool.core.files.output import check_outputs
    from animtool.core.writers import marker_writer
    from animtool.formats.marker_files import marker_file_path, write_markers

    if skip_existing_outputs(console, command, params, output, lambda: [output]):
        return
    marker_writer(output)
    files = [marker_file_path(path) for path in sources]
    check_outputs([output], files, overwrite=params["overwrite"])
    with atomic_command(), console.progress(f"{command} {sources[0].name}"):
        marker_sets = [read_marker_file(path, params) for path in sources]
        markers, report = process_markers(*marker_sets)
        notice_sources = [*marker_sets, report]
        result_files = [*sources, sources[0]]
        located_notices = (
            notice.in_file(path)
            for path, result in zip(result_files, notice_sources, strict=True)
            for notice in result.notices
        )
        # Two of the sources may be arrays of one file.
        notices = [*dict.fromkeys(located_notices)]
        refuse_warnings(notices, strict=params["strict"])
        notices += write_markers(markers, output, overwrite=params["overwrite"])
    console.faults(notices)
    written = WrittenMarkers(command, output, markers, report, notices)
    console.report(params["report_format"], written, MARKERS_TEMPLATE)
    if template is not None and params["report_format"] != "json":
        console.lines(template.text(report))
