"""``animtool plugins``."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, fields
from typing import Any

import click

from animtool.cli.console import Console
from animtool.cli.help import command
from animtool.cli.options import common_options, format_option


@command(
    epilog="""\b
Examples:
  animtool plugins
  animtool plugins --format json"""
)
@format_option
@common_options
@click.pass_obj
def plugins(console: Console, /, report_format: str) -> None:
    """List the passes that scenes may name, the files read and written, and more.

    animtool's own come first, then those installed: a package adds some through the
    entry point groups animtool.passes, animtool.readers, animtool.writers,
    animtool.executors and animtool.rules. One that does not load is listed with the
    reason, and ends nothing. animtool explain lists the rules of animtool's own.
    """
    from animtool.batch.executors import listed_executors
    from animtool.core.readers import listed_readers
    from animtool.core.rules import listed_rules
    from animtool.core.writers import listed_writers
    from animtool.motion.passes import listed_passes

    # Of each list the keys in JSON of what has another in its record, and what a line
    # calls what it has.
    listed: dict[str, tuple[dict[str, str], Any, Callable[[Any], str | None]]] = {
        "passes": ({"name": "pass"}, listed_passes(), lambda e: e.scope),
        "readers": ({"can": "opens"}, listed_readers(), lambda e: ", ".join(e.can)),
        "writers": ({"can": "writes"}, listed_writers(), lambda e: ", ".join(e.can)),
        "executors": (
            {"name": "executor"},
            listed_executors(),
            lambda e: "executor" if e.loads else None,
        ),
        "rules": ({"code": "rule"}, listed_rules(), lambda e: e.kind),
    }
    if report_format == "json":
        plugins_by_point = {
            name: [_renamed(entry, keys) for entry in entries]
            for name, (keys, entries, _) in listed.items()
        }
        console.result_json({"plugins": "animtool/1", **plugins_by_point})
        return
    for _, entries, kind in listed.values():
        for entry in entries:
            name, source, _, about = (getattr(entry, f.name) for f in fields(entry))
            shown = f"{name:14} {kind(entry) or 'broken':11} {about} ({source})"
            console.result(shown)


def _renamed(entry: Any, keys: dict[str, str]) -> dict[str, object]:
    """Return a record as plain values, some with another key."""
    return {keys.get(name, name): value for name, value in asdict(entry).items()}
