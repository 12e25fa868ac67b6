"""``animtool plugins``: the tables that plug-ins extend."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

import click

from animtool.cli.console import Console
from animtool.cli.help import command
from animtool.cli.options import common_options, format_option
from animtool.core.record import dataclass
from animtool.report.text import Each, Template

if TYPE_CHECKING:
    from animtool.core.plugins import ListedEntry


@dataclass(frozen=True, slots=True)
class Plugins:
    """The entries of every plug-in table."""

    passes: list[ListedEntry]
    readers: list[ListedEntry]
    writers: list[ListedEntry]
    executors: list[ListedEntry]
    rules: list[ListedEntry]
    json_keys: ClassVar[str] = (
        "'plugins' passes{pass=name source scope=uses about} "
        "readers{suffix=name source opens=uses about} "
        "writers{suffix=name source writes=uses about} "
        "executors{executor=name source loads=uses about} "
        "rules{rule=name source kind=uses about}"
    )


def _table_lines(table: str, kind: str) -> Each:
    """Return the template of a table's lines: name, use, description and source."""
    first_column = f"{{name:<14}} [{kind}|broken     ]"
    return Each(table, (first_column + " {about} ({source})",))


PLUGINS_TEMPLATE = Template(
    "animtool.cli.plugins:Plugins",
    (
        _table_lines("passes", "{uses:<11}"),
        _table_lines("readers", "{uses:join <11}"),
        _table_lines("writers", "{uses:join <11}"),
        _table_lines("executors", "{?uses}executor   "),
        _table_lines("rules", "{uses:<11}"),
    ),
    is_result=True,
)


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
    """List the passes, readers, writers, executors and rules, with plug-ins.

    Those of animtool come first, then those of installed packages, which use the entry
    point groups animtool.passes, animtool.readers, animtool.writers,
    animtool.executors and animtool.rules. A plug-in that does not load is listed with
    the reason. animtool explain lists the rules of animtool.
    """
    from animtool.batch.executors import listed_executors
    from animtool.core.readers import listed_readers
    from animtool.core.rules import listed_rules
    from animtool.core.writers import listed_writers
    from animtool.motion.passes import listed_passes

    entries = Plugins(
        listed_passes(),
        listed_readers(),
        listed_writers(),
        listed_executors(),
        listed_rules(),
    )
    console.report(report_format, entries, PLUGINS_TEMPLATE)
