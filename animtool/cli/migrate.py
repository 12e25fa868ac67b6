"""``animtool migrate``: files of older versions to the newest."""

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
    strict_option,
)
from animtool.report.text import Each, Template

MIGRATE_TEMPLATE = Template(
    "animtool.documents.migrate:Migrations",
    (
        Each(
            "files",
            (
                "{path}: {kind}, [{!needed}animtool/{version}, is the newest"
                "|{?is_renames_only}keys [{?written}are|would be] renamed"
                "|from animtool/{version} [{?written}is now|would become] "
                "animtool/{newest}]",
            ),
        ),
    ),
)


@command(
    epilog="""\b
Examples:
  animtool migrate hero.rig.yaml walk.clip.yaml --check
  animtool migrate hero.rig.yaml walk.clip.yaml --overwrite"""
)
@click.argument("files", nargs=-1, required=True, type=INPUT)
@click.option(
    "--check",
    is_flag=True,
    help="Write nothing; show what would change, and exit with 1 if anything would.",
)
@bake_option("overwrite", help_text="Replace files of older versions.")
@strict_option
@format_option
@common_options
@click.pass_obj
def migrate(console: Console, /, files: tuple[Path, ...], **params: Any) -> None:
    """Update rig, clip and scene FILES to the newest version, in place.

    In files of the newest version only renamed keys change. If more than the version
    changes, a YAML file is rewritten: its comments are lost, and a warning lists their
    lines. All files are checked before the first is written.
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
    console.report(params["report_format"], Migrations(plans), MIGRATE_TEMPLATE)
    if not check:
        return
    if params["report_format"] != "json":
        console.result(*(line for plan in plans for line in plan.difference))
    if any(plan.needed for plan in plans):
        click.get_current_context().exit(int(ExitCode.FINDINGS))
