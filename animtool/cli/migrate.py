"""``animtool migrate``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from animtool.cli.console import Console
from animtool.cli.help import command
from animtool.cli.options import (
    INPUT,
    common_options,
    format_option,
    overwrites,
    strict_option,
)
from animtool.core.values import VERSION, picked

if TYPE_CHECKING:
    from animtool.documents.migrate import Migration


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
@overwrites("files of older versions")
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
    from animtool.documents.migrate import migrate as run_migrate

    check = params["check"]
    plans = run_migrate(
        files, overwrite=params["overwrite"], check=check, strict=params["strict"]
    )
    for plan in plans:
        console.faults(plan.notices)
    if params["report_format"] == "json":
        entries = [
            {
                **picked(plan, "path kind from=version to=newest needed"),
                "written": plan.needed and not check,
                **picked(plan, "difference notices"),
            }
            for plan in plans
        ]
        console.result_json({"migrate": VERSION, "files": entries})
    else:
        for plan in plans:
            _say(console, plan, check=check)
    if check and any(plan.needed for plan in plans):
        click.get_current_context().exit(int(ExitCode.FINDINGS))


def _say(console: Console, plan: Migration, *, check: bool) -> None:
    if not plan.needed:
        console.say(
            f"{plan.path}: {plan.kind}, animtool/{plan.version}, is the newest version"
        )
        return
    done = "would become" if check else "is now"
    steps = f"from animtool/{plan.version} {done} animtool/{plan.newest}"
    if plan.version == plan.newest:
        steps = f"keys {'would be' if check else 'are'} renamed"
    console.say(f"{plan.path}: {plan.kind}, {steps}")
    if check:
        console.result(*plan.difference)
