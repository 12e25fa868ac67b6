"""Codes: each that is said has a page, and rules of plug-ins stand beside them."""

from __future__ import annotations

import re
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest
from support.broken_usd import BROKEN, NEAR
from support.faults import raises
from support.planted_layers import LAYERS as PLANTED_LAYERS
from support.planted_markers import MARKERS as PLANTED_MARKERS
from support.planted_takes import TAKES

from animtool.core.errors import OptionError
from animtool.core.rules import Rule, all_rules, builtin_rules, find_rule, page_text


def test_every_code_that_is_said_has_a_page_and_no_other(root: Path) -> None:
    texts = (path.read_text("utf-8") for path in (root / "animtool").rglob("*.py"))
    said = {
        c for text in texts for c in re.findall(r"\"([A-Z][A-Z0-9]{1,3}\d{3})\"", text)
    }
    rules = builtin_rules()
    checked = {code for code, rule in rules.items() if rule.check}
    assert said <= set(rules), said - set(rules)
    assert set(rules) <= said | checked, set(rules) - said


def test_checks_are_there_and_of_a_kind() -> None:
    for rule in builtin_rules().values():
        if rule.check:
            assert callable(rule.load()), rule.code
            assert rule.kinds, rule.code


# Tests that have a file with the fault and one that is nearly so: those of the examples
# of pages, by their language, and those of layers that are broken on purpose.
EXAMPLES = {
    "yaml": "validation/test_pages.py::test_the_examples_are_true",
    "bvh": "validation/test_pages.py::test_lines_of_captures_are_true",
    "usda": "usd/checks/test_pages.py::test_an_example_is_true",
}
PLANTED = "validation/motion/test_planted.py::test_a_planted_fault_is_found"
MARKERS = "validation/rules/test_trajectories.py::test_a_planted_fault_is_found"
LAYERS = "usd/checks/test_broken_layers.py::test_a_near_miss_has_no_finding"
OTHERS = "usd/checks/test_usd_validators.py"
VALIDATORS = {
    "USD280": "test_a_finding_of_usd_names_its_validator_and_the_prim",
    "USD283": "test_a_finding_of_usd_names_its_validator_and_the_prim",
    "USD284": "test_a_finding_of_usd_names_its_validator_and_the_prim",
    "USD285": "test_a_package_with_a_foreign_file_is_found",
    "USD286": "test_a_validator_of_another_plug_in_has_a_code",
}


def shown_in(code: str) -> list[str]:
    """Return the tests that a rule is shown in to find its fault, and nothing else."""
    text = page_text(code) or ""
    found = [
        test
        for language, test in EXAMPLES.items()
        if len(re.findall(rf"^```{language}$", text, re.M)) == 2
    ]
    if code in {case.code for case in BROKEN} & {case.code for case in NEAR}:
        found.append(LAYERS)
    if code in {case.code for case in (*TAKES, *PLANTED_LAYERS)}:
        found.append(PLANTED)
    if code in PLANTED_MARKERS:
        found.append(MARKERS)
    if code in VALIDATORS:
        found.append(f"{OTHERS}::{VALIDATORS[code]}")
    return found


def test_every_rule_has_its_test(root: Path) -> None:
    texts: dict[str, str] = {}
    for code in (code for code in builtin_rules() if int(code[-3:]) >= 200):
        tests = shown_in(code)
        assert tests, code
        for test in tests:
            path, _, name = test.partition("::")
            if path not in texts:
                texts[path] = (root / "tests" / path).read_text("utf-8")
            assert f"def {name}(" in texts[path], (code, test)


def test_titles_are_lines() -> None:
    for rule in builtin_rules().values():
        assert rule.title
        assert "\n" not in rule.title
        assert not rule.title.endswith(".")


def test_a_code_that_there_is_none_of() -> None:
    with raises(OptionError, "VAL005", match="RIG001"):
        find_rule("RIG0001")
    with raises(OptionError, "VAL005", match="'RIG025'"):
        find_rule("rig25")


GOOD = Rule("STU001", "a joint without a prefix", kind=builtin_rules()["RIG201"].kind,
            check=builtin_rules()["RIG201"].check)  # fmt: skip
TAKEN = Rule("RIG001", "another", kind=GOOD.kind, check=GOOD.check)
KINDLESS = Rule("STU002", "of nothing", check=GOOD.check)
LOST = Rule("STU003", "nowhere", kind=GOOD.kind, check="studio.none:check")
NUMBER = 1


@pytest.mark.parametrize(
    ("name", "value", "word"),
    [
        ("STU001", "GOOD", None),
        ("STU009", "GOOD", "has the code"),
        ("RIG001", "TAKEN", "a code of animtool's"),
        ("STU002", "KINDLESS", "no kind of file"),
        ("STU003", "LOST", "cannot be loaded"),
        ("STU004", "NUMBER", "no Rule"),
        ("STU005", "nothing", "cannot be loaded"),
    ],
)
def test_rules_of_plug_ins(
    monkeypatch: pytest.MonkeyPatch, name: str, value: str, word: str | None
) -> None:
    point = EntryPoint(name, f"core.test_rules:{value}", "animtool.rules")
    monkeypatch.setattr("animtool.core.plugins.may_have_plugins", lambda _: True)
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
        assert [fault.code for fault in broken] == ["IO003"]
        assert word in broken[0].message
        assert rules == builtin_rules()
