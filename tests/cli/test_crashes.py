"""USD files that crash USD, and what commands make of them."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest
from support.cli import animtool_process

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork")

DEPTH = 200_000


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a folder with files that crash the parser of USD, and a good one."""
    brackets = f"{'[' * DEPTH}{']' * DEPTH}"
    (tmp_path / "brackets.usda").write_text(
        f'#usda 1.0\ndef "a" {{ float[] x = {brackets} }}\n'
    )
    prims = 'def "a" {\n' * DEPTH + "}\n" * DEPTH
    (tmp_path / "prims.usda").write_text(f"#usda 1.0\n{prims}")
    (tmp_path / "good.usda").write_text('#usda 1.0\ndef "a" {}\n')
    return tmp_path


@pytest.mark.slow
def test_validate_reports_the_other_files_too(folder: Path) -> None:
    files = ["brackets.usda", "good.usda", "prims.usda"]
    done = animtool_process("validate", "--format", "json", *files, cwd=folder)
    assert done.code == 1, done.stderr
    found = {
        entry["path"]: entry["code"] for entry in json.loads(done.stdout)["findings"]
    }
    # A later USD may refuse them by itself.
    assert found.pop("brackets.usda") in {"USD001", "USD160"}
    assert found.pop("prims.usda") in {"USD001", "USD160"}
    assert set(found) == {"good.usda"}


@pytest.mark.slow
def test_info_prints_the_other_files_once(folder: Path, walk: Path) -> None:
    done = animtool_process("info", walk, "brackets.usda", cwd=folder)
    assert done.code == 3
    assert done.stdout.count("  frames  ") == 1
    assert done.stderr.startswith("brackets.usda: USD")


@pytest.mark.slow
def test_a_batch_loses_one_item(folder: Path, walk: Path) -> None:
    words = ("brackets.usda", walk, "-o", "out/{stem}.usdc", "-j", 1)
    done = animtool_process("batch", *words, "--format", "json", cwd=folder)
    assert done.code == 1, done.stderr
    items = json.loads(done.stdout)["items"]
    assert {item["status"] for item in items} == {"done", "failed"}
    assert "brackets.usda: USD160" in done.stderr
    assert (folder / "out" / "walk.usdc").exists()
