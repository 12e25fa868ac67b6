"""``animtool explain``."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from animtool.cli.console import Console
from animtool.cli.help import command
from animtool.cli.options import common_options, format_option
from animtool.core.quantities import escaped_lines

if TYPE_CHECKING:
    from animtool.core.rules import Rule


@command(
    epilog="""\b
Examples:
  animtool explain RIG201
  animtool explain
  animtool explain RIG201 --format json"""
)
@click.argument("codes", nargs=-1, metavar="[CODE]...")
@format_option
@common_options
@click.pass_obj
def explain(console: Console, /, codes: tuple[str, ...], report_format: str) -> None:
    """Say what a CODE means, why it matters and how to mend it.

    Without a code all are listed.
    """
    from animtool.core.rules import all_rules, find_rule, page_text

    rules = [find_rule(code) for code in codes]
    if not codes:
        known, broken = all_rules()
        console.faults(broken)
        rules = [known[code] for code in sorted(known)]
    if report_format == "json":
        entries = [_entry(rule, page_text(rule.code)) for rule in rules]
        console.result_json({"explain": "animtool/1", "rules": entries})
        return
    for rule in rules:
        if codes:
            console.document(page_text(rule.code) or escaped_lines(_bare_page(rule)))
        else:
            console.result(f"{rule.code:8} {rule.severity:8} {rule.title}")


def _bare_page(rule: Rule) -> str:
    """Return what is known of a code without a page, laid out as one."""
    where = "Readers and commands report it."
    if rule.kinds:
        upper = {"bvh", "usd"}
        kinds = [k.upper() if k in upper else str(k) for k in sorted(rule.kinds)]
        where = f"animtool validate looks for it in {' and '.join(kinds)} files."
    article = "An" if rule.severity == "error" else "A"
    return (
        f"# {rule.code}: {rule.title}\n\n## What\n\n"
        f"{article} {rule.severity}. {where}\n"
    )


def _entry(rule: Rule, text: str | None) -> dict[str, Any]:
    return {
        "code": rule.code,
        "title": rule.title,
        "severity": str(rule.severity),
        "kind": str(next(iter(rule.kinds))) if len(rule.kinds) == 1 else None,
        "kinds": sorted(map(str, rule.kinds)),
        "page": text,
    }
