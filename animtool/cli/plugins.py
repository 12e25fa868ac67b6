"""``animtool plugins``."""

from __future__ import annotations

import click

from animtool.cli.console import Console
from animtool.cli.options import common_options, format_option

__all__ = ["plugins"]


@click.command(
    epilog="""\b
Examples:
  animtool plugins
  animtool plugins --format json"""
)
@format_option
@common_options
@click.pass_obj
def plugins(console: Console, /, report_format: str) -> None:
    """List the passes that scenes may name, animtool's own and those installed.

    A package adds one through the entry point group animtool.passes. One that does
    not load is listed with the reason, and ends nothing.
    """
    from animtool.passes import listed_passes

    found = listed_passes()
    if report_format == "json":
        rows = [
            {"pass": e.name, "source": e.source, "scope": e.scope, "about": e.about}
            for e in found
        ]
        console.result_json({"plugins": "animtool/1", "passes": rows})
        return
    for entry in found:
        scope = entry.scope or "broken"
        console.result(f"{entry.name:14} {scope:7} {entry.about} ({entry.source})")
