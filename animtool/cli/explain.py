"""``animtool explain``: the pages of codes."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

import click

from animtool.cli.console import Console
from animtool.cli.help import command
from animtool.cli.options import common_options, format_option
from animtool.core.quantities import escaped_lines
from animtool.core.record import dataclass
from animtool.report.text import Each, Template

if TYPE_CHECKING:
    from collections.abc import Sequence

    from animtool.core.rules import Kind, Rule


@dataclass(frozen=True, slots=True)
class RulePage:
    """A code, its page and the kinds of files that its rule checks."""

    rule: Rule
    json_keys: ClassVar[str] = (
        "code=rule.code title=rule.title severity=rule.severity kind kinds page"
    )

    @property
    def page(self) -> str | None:
        """Markdown of the page; None if the code has no page."""
        from animtool.core.rules import page_text

        text = page_text(self.rule.code)
        return None if text is None else text + ignore_section(self.rule)

    @property
    def kind(self) -> Kind | None:
        """The kind of file that the rule checks, if there is exactly one."""
        return next(iter(self.kinds)) if len(self.kinds) == 1 else None

    @property
    def kinds(self) -> list[Kind]:
        """The kinds of files that the rule checks."""
        return sorted(self.rule.kinds)


@dataclass(frozen=True, slots=True)
class CodesReport:
    """Report of the requested codes, or of all codes."""

    rules: list[RulePage]
    json_keys: ClassVar[str] = "'explain' rules"


# Families of warnings about files with a key `ignore`, and about other files.
_IGNORABLE_CODES_PATTERN = "BAT|CAM|CLIP|DOC|FAC|IK|MAP|MKT|RIG|SCN|SIM|SKIN|TGT"
_OTHER_FILE_CODES_PATTERN = "BVH|C3D|FBX|GLT|LLF|MKR|MOF|MOT|TAKE|TRC|URD|USD"


def ignore_section(rule: Rule) -> str:
    """Return the page section on how to ignore a warning; "" for other codes."""
    family, heading = rule.code.rstrip("0123456789"), "\n## How to ignore it\n\n"
    is_of_other_file = re.fullmatch(_OTHER_FILE_CODES_PATTERN, family) is not None
    if rule.severity != "warning" or not (
        is_of_other_file or re.fullmatch(_IGNORABLE_CODES_PATTERN, family)
    ):
        return ""
    option = f"`animtool validate --ignore {rule.code}` leaves it out of one run."
    if is_of_other_file:
        return f"{heading}{option}\n"
    entry = f"ignore: [{{code: {rule.code}, why: it is meant}}]"
    text = f"{heading}If it is meant, say so in the file. {option}"
    return f"{text}\n\n```yaml\n{entry}\n```\n"


_PREFIX = re.compile(r"[A-Z]{2,8}[0-9]{0,2}")
_PASTED_CODE = re.compile(r"\b[A-Z][A-Z0-9]{1,7}[0-9]{3}\b")
_FAMILY = re.compile(r"[A-Za-z][A-Za-z0-9]{0,6}[A-Za-z]")


def parse_codes(arguments: Sequence[str]) -> list[str]:
    """Return the codes in arguments, which may be complete messages.

    >>> parse_codes(["RIG2", "CLIP", "107"]), parse_codes(["warning: CLIP110 hips"])
    (['RIG2', 'CLIP107'], ['CLIP110'])
    >>> parse_codes(["C3D", "104", "107"])
    ['C3D104', '107']
    """
    codes: list[str] = []
    for argument in arguments:
        text = re.sub(r"([A-Za-z]) ([0-9]{3})\b", r"\1\2", argument)
        if re.fullmatch("[0-9]{3}", text) and _FAMILY.fullmatch("".join(codes[-1:])):
            codes[-1] += text
        else:
            codes += (" " in text and _PASTED_CODE.findall(text)) or [text]
    return codes


CODES_TEMPLATE = Template(
    "animtool.cli.explain:CodesReport",
    (Each("rules", ("{rule.code:<8} {rule.severity:<8} {rule.title}",)),),
    is_result=True,
)


def _refuse_command_name(code: str) -> None:
    """Refuse the name of a command where a code is expected (VAL005)."""
    from animtool.cli.main import COMMANDS
    from animtool.core.errors import Fault, OptionError

    name = code.lower()
    if name in COMMANDS:
        hint = f"animtool docs {name} explains the command"
        raise OptionError(Fault("VAL005", f"unknown code {code!r}", hint=hint))
    if not code.isalnum() and Path(code).exists():
        hint = f"it is a path: animtool validate {code} lists its findings"
        raise OptionError(Fault("VAL005", f"unknown code {code!r}", hint=hint))


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
    """Explain a CODE: what it means, why it matters and how to fix it.

    A prefix such as RIG2 lists the codes that start with it; without a code, all codes
    are listed.
    """
    from animtool.core.rules import all_rules, find_rule

    rules = []
    is_listing = not codes
    for code in parse_codes(codes):
        # RIG2 means all codes with that prefix.
        prefix = code.upper()
        rules_by_code = all_rules()[0] if _PREFIX.fullmatch(prefix) else {}
        matching_codes = sorted(c for c in rules_by_code if c.startswith(prefix))
        matching_rules = [rules_by_code[c] for c in matching_codes]
        if not matching_rules:
            _refuse_command_name(code)
        is_listing = is_listing or len(matching_rules) > 1
        rules += matching_rules or [find_rule(code)]
    if not codes:
        rules_by_code, failed_rules = all_rules()
        console.faults(failed_rules)
        rules = [rules_by_code[code] for code in sorted(rules_by_code)]
    if not is_listing and report_format != "json":
        for rule in rules:
            console.document(RulePage(rule).page or escaped_lines(_default_page(rule)))
        return
    pages = CodesReport([RulePage(rule) for rule in rules])
    console.report(report_format, pages, CODES_TEMPLATE)


def _default_page(rule: Rule) -> str:
    """Return a generated page for a code that has no page."""
    origin = "Readers and commands report it."
    if rule.kinds:
        acronyms = {"bvh": "BVH", "usd": "USD"}
        kinds = [acronyms.get(kind, str(kind)) for kind in sorted(rule.kinds)]
        origin = f"animtool validate looks for it in {' and '.join(kinds)} files."
    article = "An" if rule.severity == "error" else "A"
    return (
        f"# {rule.code}: {rule.title}\n\n## What\n\n"
        f"{article} {rule.severity}. {origin}\n"
    )
