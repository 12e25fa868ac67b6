"""``animtool preview``: shows files on a page, in a picture or a film."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from animtool.cli.console import Console
from animtool.cli.help import command
from animtool.cli.options import (
    INPUT,
    bake_option,
    common_options,
    format_option,
    output_option,
    read_source_options,
    read_values,
    record_options,
    source_option,
    source_options,
    variables_option,
)
from animtool.core.options import changed_options
from animtool.preview.options import PictureOptions, PreviewOptions, ShowOptions

_SOURCE_OPTIONS = (
    *("rig", "take", "positions", "remap", "dropped", "template", "cameras"),
)


@command(
    epilog="""\b
Examples:
  animtool preview walk.bvh
  animtool preview walk.bvh -o walk.html
  animtool preview walk.bvh walk.usdc -o compared.html
  animtool preview hero.rig.yaml reach.targets.yaml
  animtool preview walk.clip.yaml --watch
  animtool preview shot.usda --range 1001-1100 -o shot.html
  animtool preview walk.bvh -o walk.png --range 1,20,40
  animtool preview hero.rig.yaml -o hero.webm --turntable"""
)
@click.argument("files", nargs=-1, required=True, type=INPUT)
@output_option(
    "Write the page (.html), or a picture or film of it (.png, .gif, .webp, "
    ".mp4, .webm).  [default: a temporary page, which is opened]",
    metavar="FILE",
)
@record_options(ShowOptions)
@record_options(PreviewOptions, "frame_range", "findings")
@source_options
@record_options(PreviewOptions, "prim_path", "over")
@record_options(PictureOptions)
@source_option(*_SOURCE_OPTIONS)
@variables_option
@bake_option("overwrite", help_text="Replace a page or picture that exists.")
@format_option
@common_options
@click.pass_obj
def preview(console: Console, /, files: tuple[Path, ...], **params: Any) -> None:
    """Show FILES on a page that plays, in a browser, or in a picture or film.

    Shows BVH, USD, clips, rigs, scenes, targets, markers and motion files; several
    takes are compared. The page is one file that needs no network. A scene is baked
    first. Pictures need the extra `pictures`, but no graphics card.
    """
    from animtool.cli import preview_page
    from animtool.preview.pictures.kinds import picture_kind

    output, report_format = params["output"], params["report_format"]
    show_options = ShowOptions(**read_values(ShowOptions, params))
    preview_values = read_values(PreviewOptions, params)
    picture_options = PictureOptions(**read_values(PictureOptions, params))
    is_picture = output is not None and picture_kind(output) is not None
    if not is_picture and (picture_flags := changed_options(picture_options)):
        flag = next(iter(picture_flags))
        raise click.UsageError(f"--{flag} applies to pictures, such as -o walk.png.")
    is_json = report_format == "json"
    if show_options.watch and (output is not None or is_json or show_options.plan):
        message = "--watch serves the page: remove -o, --plan and --format json."
        raise click.UsageError(message)
    options = PreviewOptions(
        source=read_source_options(params, *_SOURCE_OPTIONS),
        variables=dict(params["variables"]),
        **{name: value for name, value in preview_values.items() if value is not None},
    )
    if show_options.plan:
        preview_page.print_plan(console, files, output, options, report_format)
    elif show_options.watch:
        preview_page.serve_preview(console, files, options, show_options)
    elif output is not None and is_picture:
        preview_page.write_picture(
            console,
            files,
            output,
            options,
            picture_options,
            report_format,
            overwrite=params["overwrite"],
        )
    else:
        preview_page.write_preview(
            console,
            files,
            output,
            options,
            show_options,
            report_format,
            overwrite=params["overwrite"],
        )
