"""``animtool migrate``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from animtool.cli.console import Console
from animtool.cli.options import (
    INPUT,
    bake_option,
    common_options,
    format_option,
    strict_option,
)
from animtool.report.text import Each, Template

MIGRATED = Template(
    "animtool.documents.migrate:Migrations",
    (
        Each(
            "files",
            (
                "{path}: {kind}, [{!needed}animtool/{version}, is the newest"
                "|{?renames}keys [{?written}are|would be] renamed"
                "|from animtool/{version} [{?written}is now|would become] "
                "animtool/{newest}]",
            ),
        ),
    ),
)


@click.command(
    epilog="""\b
Examples:
  animtool migrate hero.rig.yaml walk.clip.yaml --check
  animtool migrate hero.rig.yaml walk.clip.yaml --overwrite"""
)
@click.argument("files", nargs=-1, required=True, type=INPUT)
@click.option(
    "--check",
    is_flag=True,
    help="Write nothing; say what would change, and end with 1 where something would.",
)
@bake_option("overwrite", about="Replace files of older versions.")
@strict_option
@format_option
@common_options
@click.pass_obj
def migrate(console: Console, /, files: tuple[Path, ...], **params: Any) -> None:
    """Rewrite rig, clip and scene FILES of older versions as the newest, in place.

    Files of the newest version are left alone, but for keys that have a new name. Where
    more than the version's name changes, a YAML file is written anew: its comments are
    not kept, and a warning says in which lines they were. All files are checked before
    the first is written.
    """
    from animtool.core.errors import ExitCode
    from animtool.documents.migrate import Migrations
    from animtool.documents.migrate import migrate as run_migrate

    check = params["check"]
    plans = run_migrate(
        files, overwrite=params["overwrite"], check=check, strict=params["strict"]
    )
    for plan in plans:
        console.faults(plan.notices)
    console.report(params["report_format"], Migrations(plans), MIGRATED)
    if not check:
        return
    if params["report_format"] != "json":
        console.result(*(line for plan in plans for line in plan.difference))
    if any(plan.needed for plan in plans):
        click.get_current_context().exit(int(ExitCode.FINDINGS))
