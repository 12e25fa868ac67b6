"""Writes, serves or describes preview pages, and writes preview pictures."""

from __future__ import annotations

import sys
import threading
from pathlib import Path

from animtool.cli.console import Console
from animtool.cli.summary import PLAN_TEMPLATE
from animtool.core.files.output import check_outputs
from animtool.preview.build import PreviewPage, check_page_output, make_page, write_page
from animtool.preview.options import PictureOptions, PreviewOptions, ShowOptions
from animtool.preview.pictures.build import write_pictures
from animtool.preview.pictures.kinds import picture_kind
from animtool.preview.plan import page_steps
from animtool.preview.serve import PageServer, WatchedPage, rebuild_on_changes
from animtool.preview.show import has_browser, open_browser, temporary_page
from animtool.report.text import Each, Template
from animtool.scene.bake.steps import PlanSteps


def print_plan(
    console: Console,
    files: tuple[Path, ...],
    output: Path | None,
    options: PreviewOptions,
    report_format: str,
) -> None:
    """Print the steps by which a page would be built."""
    if output is not None:
        picture_kind(output)
        check_outputs([output], files, overwrite=True)
    steps = page_steps(files, output, options)
    console.report(report_format, PlanSteps(steps), PLAN_TEMPLATE)


# Content, accuracy and omissions of a page.
PAGE_TEMPLATE = Template(
    "animtool.preview.build:PageReport",
    (
        "{page.manifest.time.count:n frame}[, {page.manifest.takes:n take}]"
        "[, {page.manifest.meshes:n mesh/meshes}]"
        "[, {page.manifest.curves3d:n set of curves/sets of curves}]"
        "[, {page.manifest.points:n set of points/sets of points}]"
        "[, {page.manifest.instances:n set of copies/sets of copies}]"
        "[, {page.manifest.cameras:n camera}][, {page.manifest.channels:n curve}]"
        "[, {page.manifest.findings:n finding} ({codes:list 8})]",
        "  exact within {page.manifest.errors.position_mm:g} mm and "
        "{page.manifest.errors.rotation_deg:g} degrees",
        Each("page.manifest.notices", ("  {self}",)),
        "{path}: {size:size}",
    ),
)
PICTURE_TEMPLATE = Template(
    "animtool.preview.pictures.build:PictureReport",
    (
        Each("page.manifest.notices", ("  {self}",)),
        "{path}: {frames:n frame}[{?rate} at {rate:g} a second"
        "[, every {every}. of the motion]], {width}x{height} pixels, {about}, "
        "{size:size}",
    ),
)


def write_preview(
    console: Console,
    files: tuple[Path, ...],
    output: Path | None,
    options: PreviewOptions,
    show_options: ShowOptions,
    report_format: str,
    *,
    overwrite: bool,
) -> None:
    """Write a page and open it in a browser, if one is available."""
    opens_browser = show_options.opened
    if opens_browser is None:
        opens_browser = output is None and has_browser()
    if output is not None:
        check_page_output(output, files, overwrite=overwrite)
    target = temporary_page() if output is None else output
    with console.progress(f"preview {files[0].name}"):
        report = write_page(files, target, options, overwrite=overwrite)
    console.report(report_format, report, PAGE_TEMPLATE, report.page.notices)
    if opens_browser and not open_browser(target.resolve().as_uri()):
        console.say("no browser was found")
        opens_browser = False
    if output is None and not opens_browser and report_format != "json":
        console.result(str(target))


def write_picture(
    console: Console,
    files: tuple[Path, ...],
    output: Path,
    options: PreviewOptions,
    picture_options: PictureOptions,
    report_format: str,
    *,
    overwrite: bool,
) -> None:
    """Write a still picture, a contact sheet or a film."""
    with console.progress(f"preview {files[0].name}") as progress:
        report = write_pictures(
            files,
            output,
            options,
            picture_options,
            overwrite=overwrite,
            progress=progress,
        )
    console.report(report_format, report, PICTURE_TEMPLATE, report.page.notices)


def serve_preview(
    console: Console,
    files: tuple[Path, ...],
    options: PreviewOptions,
    show_options: ShowOptions,
) -> None:
    """Serve a page that reloads when its files change, until Ctrl-C."""
    opens_browser = (
        has_browser() if show_options.opened is None else show_options.opened
    )
    watched_page = WatchedPage(lambda: make_page(files, options))
    watched_page.build()
    assert watched_page.page is not None
    console.faults(watched_page.page.notices)
    with PageServer(watched_page) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        if not opens_browser or not open_browser(server.address):
            console.result(server.address)
            sys.stdout.flush()
        console.say("watching; press Ctrl-C to stop")

        def report_built(page: PreviewPage) -> None:
            console.faults(page.notices)
            console.say(f"reloaded: page {watched_page.version}")

        try:
            rebuild_on_changes(
                watched_page,
                lambda error: console.faults(error.faults),
                report_built,
                threading.Event().wait,
            )
        finally:
            server.shutdown()
