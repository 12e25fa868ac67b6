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
    """List the passes that scenes may name, and the files that are read.

    animtool's own come first, then those installed: a package adds some through the
    entry point groups animtool.passes and animtool.readers. One that does not load
    is listed with the reason, and ends nothing.
    """
    from animtool.passes import listed_passes
    from animtool.readers import listed_readers

    passes, readers = listed_passes(), listed_readers()
    if report_format == "json":
        pass_rows = [
            {"pass": e.name, "source": e.source, "scope": e.scope, "about": e.about}
            for e in passes
        ]
        reader_rows = [
            {"suffix": e.suffix, "source": e.source, "opens": e.opens, "about": e.about}
            for e in readers
        ]
        console.result_json(
            {"plugins": "animtool/1", "passes": pass_rows, "readers": reader_rows}
        )
        return
    rows = [(e.name, e.scope or "broken", e.about, e.source) for e in passes]
    rows += [
        (e.suffix, ", ".join(e.opens) or "broken", e.about, e.source) for e in readers
    ]
    for name, kind, about, source in rows:
        console.result(f"{name:14} {kind:11} {about} ({source})")
