"""Paths of other machines."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path, PurePosixPath, PureWindowsPath

import pytest

from animtool.batch.item import PathRule, map_batch_paths, map_path, read_path_rules
from animtool.batch.spec import BatchSpec
from animtool.core.errors import FormatError

RULE = (
    '{"path_mapping_rules": [{"source_path_format": "POSIX", '
    '"source_path": "/there", "destination_path": "/here"}]}'
)
OUTER = PathRule(PurePosixPath("/show"), "/mnt/show")
INNER = PathRule(PurePosixPath("/show/takes"), "/fast")
DRIVE = PathRule(PureWindowsPath("Z:\\show"), "/mnt/show")


@pytest.mark.parametrize(
    ("text", "mapped"),
    [
        ("/show/a.bvh", "/mnt/show/a.bvh"),
        ("/show", "/mnt/show"),
        ("/shows/a.bvh", "/shows/a.bvh"),
        ("/show/takes/**/*.bvh", "/fast/**/*.bvh"),
        ("show/a.bvh", "show/a.bvh"),
        ("z:\\SHOW\\a\\b.bvh", "/mnt/show/a/b.bvh"),
        ("out/{stem}.usdc", "out/{stem}.usdc"),
    ],
)
def test_the_innermost_folder_decides(text: str, mapped: str) -> None:
    for rules in ([OUTER, INNER, DRIVE], [DRIVE, INNER, OUTER]):
        assert map_path(text, rules) == mapped


def test_inputs_and_outputs_are_mapped() -> None:
    spec = BatchSpec(("/show/a", "b"), exclude=("/show/c",), output="/show/{stem}.usdc")
    found = map_batch_paths(spec, [OUTER])
    assert found.inputs == ("/mnt/show/a", "b")
    assert found.exclude == ("/mnt/show/c",)
    assert found.output == "/mnt/show/{stem}.usdc"
    assert map_batch_paths(spec, []) is spec


def test_an_output_that_is_not_mapped_stays_in_the_folders_of_its_batch() -> None:
    own = (Path("/show"),)
    spec = BatchSpec(("a",), output="out/{stem}.usdc", roots=own)
    assert map_batch_paths(spec, [OUTER]).roots == own
    there = replace(spec, output="/show/{stem}.usdc")
    assert map_batch_paths(there, [OUTER]).roots == ()


def test_rules_of_a_file(tmp_path: Path) -> None:
    path = tmp_path / "rules.json"
    path.write_text("{}")
    assert read_path_rules(path) == []
    rule = {
        "source_path_format": "WINDOWS",
        "source_path": "Z:\\show",
        "destination_path": "/mnt/show",
    }
    path.write_text(json.dumps({"path_mapping_rules": [rule]}))
    assert read_path_rules(path) == [DRIVE]


@pytest.mark.parametrize(
    "text",
    [
        *(None, "", "[]", '{"path_mapping_rules": [{}]}', '{"path_mapping_rules": 1}'),
        *("[" * 100_000, '{"a": NaN}', '{"path_mapping_rules": [], "a": 1, "a": 2}'),
        RULE.replace('"/here"', '{"a": 1}'),
        RULE.replace('"/here"', '"/he\\u0000re"'),
        RULE.replace('"/there"', "7"),
        RULE.replace('"POSIX"', '["POSIX"]'),
    ],
)
def test_what_is_no_file_of_rules(tmp_path: Path, text: str | None) -> None:
    path = tmp_path / "rules.json"
    if text is not None:
        path.write_text(text)
    with pytest.raises(FormatError) as error:
        read_path_rules(path)
    assert error.value.code == "BAT038"
