"""``animtool preview``."""

from __future__ import annotations

import sys
import threading
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from animtool.cli.console import Console
from animtool.cli.options import (
    INPUT,
    common_options,
    format_option,
    read_values,
    record_option,
    set_option,
    source_option,
    source_options,
    source_options_record,
)
from animtool.preview.options import PreviewOptions

if TYPE_CHECKING:
    from animtool.preview.build import Page

_OF_SOURCES = ("rig", "take", "positions", "remap", "dropped", "template", "cameras")


@click.command(
    epilog="""\b
Examples:
  animtool preview walk.bvh
  animtool preview walk.bvh -o walk.html
  animtool preview walk.bvh walk.usdc -o compared.html
  animtool preview walk.clip.yaml --watch
  animtool preview shot.usda --frames 1001-1100 -o shot.html"""
)
@click.argument("files", nargs=-1, required=True, type=INPUT)
@click.option(
    "-o",
    "--output",
    type=INPUT,
    metavar="FILE",
    help="Write the page here (.html).  [default: a temporary file, which is opened]",
)
@click.option(
    "--open/--no-open",
    "opened",
    default=None,
    help="Open the page in the browser, or print its path.  [default: open it, but "
    "not over ssh, without a display, or with -o]",
)
@click.option(
    "--watch",
    is_flag=True,
    help="Serve the page on this machine alone, and reload it when a file changes.",
)
@record_option(PreviewOptions, "frame_range", "findings")
@source_options
@click.option(
    "--prim-path", metavar="PATH", help="What to show of a USD file.  [default: all]"
)
@source_option(*_OF_SOURCES)
@set_option
@click.option("--overwrite", is_flag=True, help="Replace a page that exists.")
@format_option
@common_options
@click.pass_obj
def preview(console: Console, /, files: tuple[Path, ...], **params: Any) -> None:
    """Show FILES on a page that plays, in a browser.

    BVH, USD, clips, rigs, scenes, markers and motion files; several takes are compared.
    The page is one file that needs no network, and can be mailed. A scene is baked for
    it.
    """
    from animtool.preview.build import check_page_output, write_page
    from animtool.preview.show import has_browser, open_browser, temporary_page

    output = params["output"]
    if params["watch"] and (output is not None or params["report_format"] == "json"):
        raise click.UsageError("--watch serves the page: no -o and no --format json.")
    options = _options(params)
    shows = params["opened"]
    if shows is None:
        shows = output is None and has_browser()
    if params["watch"]:
        _watch(console, files, options, shows=shows)
        return
    if output is not None:
        check_page_output(output, files, overwrite=params["overwrite"])
    target = temporary_page() if output is None else output
    with console.progress(f"preview {files[0].name}"):
        report = write_page(files, target, options, overwrite=params["overwrite"])
    console.faults(report.page.notices)
    if params["report_format"] == "json":
        console.result_json(report.as_dict())
    else:
        _say(console, report.page)
        console.say(f"{target}: {_size(report.size)}")
    if shows and not open_browser(target.resolve().as_uri()):
        console.say("no browser was found")
        shows = False
    if output is None and not shows and params["report_format"] != "json":
        console.result(str(target))


def _options(params: dict[str, Any]) -> PreviewOptions:
    values = read_values(PreviewOptions, params)
    if values["findings"] is None:
        values["findings"] = True
    return PreviewOptions(
        source=source_options_record(params, *_OF_SOURCES),
        prim_path=params["prim_path"],
        variables=dict(params["variables"]),
        **values,
    )


def _watch(
    console: Console, files: tuple[Path, ...], options: PreviewOptions, *, shows: bool
) -> None:
    """Serve a page until the command is interrupted."""
    from animtool.core.errors import AnimtoolError
    from animtool.preview.build import make_page
    from animtool.preview.serve import PageServer, Watched, follow
    from animtool.preview.show import open_browser

    watched = Watched(lambda: make_page(files, options))
    watched.build()
    assert watched.page is not None
    console.faults(watched.page.notices)
    with PageServer(watched) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        if not shows or not open_browser(server.address):
            console.result(server.address)
            sys.stdout.flush()
        console.say("watching; interrupt (Ctrl-C) to end")

        def failed(error: AnimtoolError) -> None:
            console.faults(error.faults)

        def made(page: Page) -> None:
            console.faults(page.notices)
            console.say(f"reloaded: page {watched.version}")

        try:
            follow(watched, failed, made, threading.Event().wait)
        finally:
            server.shutdown()


def _say(console: Console, page: Page) -> None:
    """Say what a page shows, how exactly, and what it does not show."""
    from animtool.core.errors import counted

    manifest = page.manifest
    nouns = (
        ("takes", "take", ""),
        ("meshes", "mesh", "meshes"),
        ("curves3d", "set of curves", "sets of curves"),
        ("points", "set of points", "sets of points"),
        ("instances", "set of copies", "sets of copies"),
        ("cameras", "camera", ""),
        ("channels", "curve", ""),
        ("findings", "finding", ""),
    )
    parts = [counted(manifest["time"]["count"], "frame")]
    parts += [
        counted(len(manifest[key]), *filter(None, words))
        for key, *words in nouns
        if manifest[key]
    ]
    console.say(", ".join(parts))
    errors = manifest["errors"]
    console.say(
        f"  exact within {errors['position_mm']:g} mm and "
        f"{errors['rotation_deg']:g} degrees"
    )
    for notice in manifest["notices"]:
        console.say(f"  {notice}")


def _size(count: int) -> str:
    return f"{count / 1e6:.3g} MB" if count >= 1e6 else f"{count / 1e3:.3g} kB"
