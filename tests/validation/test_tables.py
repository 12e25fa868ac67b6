"""The table of codes: it has every code that is said, and no other."""

from __future__ import annotations

import re
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

from animtool.errors import OptionError
from animtool.validation.rule import Rule
from animtool.validation.tables import RULES, all_rules, find_rule


def test_every_code_is_in_the_table(root: Path) -> None:
    said = set()
    for path in (root / "animtool").rglob("*.py"):
        tables = path.parent.name == "tables" and path.name != "__init__.py"
        if not tables:
            text = path.read_text("utf-8")
            said |= set(re.findall(r"\"([A-Z]{2,4}\d{3})\"", text))
    assert said <= set(RULES), said - set(RULES)
    assert set(RULES) <= said, set(RULES) - said


@pytest.mark.parametrize("rule", [r for r in RULES.values() if r.check])
def test_a_check_is_there_and_of_a_kind(rule: Rule) -> None:
    assert callable(rule.load())
    assert rule.kind is not None
    assert int(rule.code[-3:]) >= 201


def test_titles_are_lines() -> None:
    for rule in RULES.values():
        assert rule.title
        assert "\n" not in rule.title
        assert not rule.title.endswith(".")


def test_a_code_that_there_is_none_of() -> None:
    with pytest.raises(OptionError, match="RIG001") as error:
        find_rule("RIG0001")
    assert error.value.code == "VAL005"


GOOD = Rule("STU001", "a joint without a prefix", kind=RULES["RIG201"].kind,
            check=RULES["RIG201"].check)  # fmt: skip
TAKEN = Rule("RIG001", "another", kind=GOOD.kind, check=GOOD.check)
KINDLESS = Rule("STU002", "of nothing", check=GOOD.check)
LOST = Rule("STU003", "nowhere", kind=GOOD.kind, check="studio.none:check")
NUMBER = 1


@pytest.mark.parametrize(
    ("name", "value", "word"),
    [
        ("STU001", "GOOD", None),
        ("STU009", "GOOD", "has the code"),
        ("RIG001", "TAKEN", "animtool's own"),
        ("STU002", "KINDLESS", "no kind of file"),
        ("STU003", "LOST", "cannot be loaded"),
        ("STU004", "NUMBER", "no Rule"),
        ("STU005", "nothing", "cannot be loaded"),
    ],
)
def test_rules_of_plug_ins(
    monkeypatch: pytest.MonkeyPatch, name: str, value: str, word: str | None
) -> None:
    point = EntryPoint(name, f"validation.test_tables:{value}", "animtool.rules")
    monkeypatch.setattr("importlib.metadata.entry_points", lambda **_: [point])
    all_rules.cache_clear()
    try:
        rules, broken = all_rules()
    finally:
        monkeypatch.undo()
        all_rules.cache_clear()
    if word is None:
        assert not broken
        assert rules["STU001"].title == GOOD.title
    else:
        assert [fault.code for fault in broken] == ["VAL004"]
        assert word in broken[0].message
        assert rules == RULES
