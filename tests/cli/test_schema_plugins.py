"""``schema`` and ``plugins``: what files may say, and which passes there are."""

from __future__ import annotations

import json

import pytest
from support.cli import animtool
from support.plugins import install

from animtool.batch.executors import EXECUTORS
from animtool.cli.schema import MODELS
from animtool.core.readers import READERS
from animtool.motion.passes import PASSES


@pytest.mark.parametrize("kind", sorted(MODELS))
def test_a_schema_describes_its_file(kind: str) -> None:
    done = animtool("schema", kind)
    assert done.code == 0
    described = json.loads(done.stdout)
    assert kind in described["properties"]
    assert kind in described["required"]
    assert described["additionalProperties"] is False


def test_every_pass_is_listed() -> None:
    done = animtool("plugins", "--format", "json")
    rows = {row["pass"]: row for row in json.loads(done.stdout)["passes"]}
    assert set(rows) == set(PASSES)
    assert all(row["scope"] for row in rows.values())


def test_every_reader_is_listed() -> None:
    done = animtool("plugins", "--format", "json")
    rows = {row["suffix"]: row for row in json.loads(done.stdout)["readers"]}
    assert set(rows) == set(READERS)
    for suffix, reader in READERS.items():
        named = ("rig", "source", "markers")
        assert rows[suffix]["opens"] == [n for n in named if getattr(reader, n)]


def test_every_executor_is_listed() -> None:
    done = animtool("plugins", "--format", "json")
    rows = {row["executor"]: row for row in json.loads(done.stdout)["executors"]}
    assert set(rows) == set(EXECUTORS)
    assert all(row["loads"] for row in rows.values())


def test_a_broken_plugin_is_named_and_ends_nothing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    install(monkeypatch, "animtool.passes", shatter="no_such_module:PASS")
    done = animtool("plugins")
    assert done.code == 0
    line = next(row for row in done.stdout.splitlines() if row.startswith("shatter"))
    assert "broken" in line
    assert "no_such_module" in line


def test_rules_of_plug_ins_are_listed(monkeypatch: pytest.MonkeyPatch) -> None:
    rules = {"STU001": "core.test_rules:GOOD", "STU002": "no_such_module:RULE"}
    install(monkeypatch, "animtool.rules", **rules)
    rows = json.loads(animtool("plugins", "--format", "json").stdout)["rules"]
    assert [(row["rule"], row["kind"]) for row in rows] == [
        ("STU001", "rig"),
        ("STU002", ""),
    ]
