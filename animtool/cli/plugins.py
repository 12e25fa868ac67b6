"""``animtool plugins``."""

from __future__ import annotations

import click

from animtool.cli.console import Console
from animtool.cli.options import common_options, format_option


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
    """List the passes that scenes may name, the files that are read, and more.

    animtool's own come first, then those installed: a package adds some through the
    entry point groups animtool.passes, animtool.readers, animtool.executors and
    animtool.rules. One that does not load is listed with the reason, and ends nothing.
    animtool explain lists the rules of animtool's own.
    """
    from animtool.batch.executors import listed_executors
    from animtool.passes import listed_passes
    from animtool.readers import listed_readers
    from animtool.rules import listed_rules

    passes, readers, rules = listed_passes(), listed_readers(), listed_rules()
    executors = listed_executors()
    if report_format == "json":
        pass_rows = [
            {"pass": e.name, "source": e.source, "scope": e.scope, "about": e.about}
            for e in passes
        ]
        reader_rows = [
            {"suffix": e.suffix, "source": e.source, "opens": e.opens, "about": e.about}
            for e in readers
        ]
        executor_rows = [
            {
                "executor": e.name,
                "source": e.source,
                "loads": e.loads,
                "about": e.about,
            }
            for e in executors
        ]
        rule_rows = [
            {"rule": e.code, "source": e.source, "kind": e.kind, "about": e.about}
            for e in rules
        ]
        console.result_json(
            {
                "plugins": "animtool/1",
                "passes": pass_rows,
                "readers": reader_rows,
                "executors": executor_rows,
                "rules": rule_rows,
            }
        )
        return
    rows = [(e.name, e.scope or "broken", e.about, e.source) for e in passes]
    rows += [
        (e.suffix, ", ".join(e.opens) or "broken", e.about, e.source) for e in readers
    ]
    rows += [
        (e.name, "executor" if e.loads else "broken", e.about, e.source)
        for e in executors
    ]
    rows += [(e.code, e.kind or "broken", e.about, e.source) for e in rules]
    for name, kind, about, source in rows:
        console.result(f"{name:14} {kind:11} {about} ({source})")
