"""``animtool plugins``."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

import click

from animtool.cli.console import Console
from animtool.cli.help import command
from animtool.cli.options import common_options, format_option
from animtool.core.record import dataclass
from animtool.report.text import Each, Template

if TYPE_CHECKING:
    from animtool.batch.executors import ListedExecutor
    from animtool.core.plugins import ListedFormat
    from animtool.core.rules import ListedRule
    from animtool.motion.passes import ListedPass


@dataclass(frozen=True, slots=True)
class Plugins:
    """The entries of each plug-in table."""

    passes: list[ListedPass]
    readers: list[ListedFormat]
    writers: list[ListedFormat]
    executors: list[ListedExecutor]
    rules: list[ListedRule]
    json_keys: ClassVar[str] = (
        "'plugins' passes readers{suffix source opens=can about} "
        "writers{suffix source writes=can about} executors rules"
    )


def _lines(table: str, name: str, kind: str) -> Each:
    """Return the lines of a plug-in table; kind: label of loaded entries."""
    first_column = f"{{{name}:<14}} [{kind}|broken     ]"
    return Each(table, (first_column + " {about} ({source})",))


PLUGINS = Template(
    "animtool.cli.plugins:Plugins",
    (
        _lines("passes", "name", "{scope:<11}"),
        _lines("readers", "suffix", "{can:join <11}"),
        _lines("writers", "suffix", "{can:join <11}"),
        _lines("executors", "name", "{?loads}executor   "),
        _lines("rules", "code", "{kind:<11}"),
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
    console.report(report_format, entries, PLUGINS)
