"""The page of promises and limits says what the code has."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from animtool.core.clock import MAX_FRAME_COUNT
from animtool.core.files.reading import MAX_INPUT_BYTES, MAX_TEXT_BYTES
from animtool.core.rules import builtin_rules
from animtool.documents import archive, fields, variables, yaml_values
from animtool.documents.document import MAX_FAULTS
from animtool.formats.bvh.lines import MAX_HEADER_LINES
from animtool.scene.systems.run import MAX_STEP_COUNT
from animtool.usd.layers.sdf import MAX_LAYER_BYTES, MAX_TEXT_LAYER_BYTES


@pytest.fixture(scope="module")
def page(root: Path) -> str:
    text = (root / "animtool/docs/security.md").read_text("utf-8")
    return " ".join(text.split())


def test_its_limits_are_those_of_the_code(page: str) -> None:
    assert f"{MAX_TEXT_BYTES // 10**6} MB | DOC006, IO010" in page
    assert f"{yaml_values.MAX_SEPARATORS // 10**6} million separators" in page
    assert (
        f"{yaml_values.MAX_KEY_LENGTH:,} and {variables.MAX_TEXT_LENGTH:,} letters"
        in page
    )
    assert fields.MAX_NUMBER == 1e18
    assert fields.MAX_FRAME == 1e9
    assert fields.MAX_INTEGER == 2**53
    assert "±1e18; frames ±1e9; whole numbers ±2^53" in page
    assert f"reported of a file | {MAX_FAULTS} |" in page
    assert (
        f"{archive.DEFAULT_ARRAY_LIMIT // 10**9} GB as float64; "
        f"{archive.MAX_COMPRESSION_RATIO} " in page
    )
    assert f"cut lists, reports | {MAX_INPUT_BYTES // 10**9} GB" in page
    assert (MAX_TEXT_LAYER_BYTES, MAX_LAYER_BYTES) == (4 * 10**9, 10**12)
    assert "4 GB, 1 TB" in page
    assert MAX_HEADER_LINES == 10**6
    assert "of the header: a million" in page
    assert MAX_STEP_COUNT == MAX_FRAME_COUNT == 10**7
    assert page.count("| 10 million |") == 3


def test_its_codes_are_codes(page: str) -> None:
    codes = set(re.findall(r"\b[A-Z]{2,4}\d{3}\b", page))
    assert codes
    assert codes <= set(builtin_rules())


def test_its_files_are_there(root: Path, page: str) -> None:
    named = re.findall(r"`(tests/[\w/.]+)`", page)
    assert len(named) >= 4
    assert all((root / name).exists() for name in named)
