"""``animtool report``."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from support.cli import animtool

from animtool.report.tradeoffs_schema import TradeoffsModel
from animtool.scene.tables.tradeoffs import SUITE_FOLDER

CLIP = SUITE_FOLDER / "arm.clip.yaml"


def test_json_is_as_its_schema_says() -> None:
    done = animtool("report", CLIP, "--budget", "2mm", "--format", "json")
    assert done.code == 0, done.stderr
    report = TradeoffsModel.model_validate(json.loads(done.stdout))
    assert (report.source, report.budget) == (str(CLIP), 0.002)
    assert report.tables[0].lines == ["animtool bake arm.clip.yaml --fps 48"]
    keys = "animtool convert arm.clip.yaml arm.reduced.clip.yaml --reduce 1mm"
    assert report.tables[1].lines == [keys]
    schema = json.loads(animtool("schema", "report").stdout)
    assert schema["required"] == list(json.loads(done.stdout))


def test_words_have_the_cheapest_and_what_to_write() -> None:
    done = animtool("report", CLIP, "--budget", "2mm")
    assert done.code == 0, done.stderr
    lines = [line.strip() for line in done.stdout.splitlines()]
    assert "animtool bake arm.clip.yaml --fps 48" in lines
    assert any(line.startswith("cheapest within 2 mm: rate, fps 48") for line in lines)


@pytest.mark.parametrize("command", ["report", "bake"])
@pytest.mark.parametrize(
    ("words", "code"),
    [
        (("--source-fps", "30000/10001"), "TAKE011"),
        (("--source-fps", "2400"), "TAKE009"),
        (("--units", "m"), "RIG217"),
    ],
)
def test_a_table_has_the_notices_of_a_bake(
    root: Path, tmp_path: Path, command: str, words: tuple[str, ...], code: str
) -> None:
    walk = root / "samples/walk/walk.bvh"
    output = ["-o", tmp_path / "o.usdc"] if command == "bake" else []
    done = animtool(command, walk, *words, *output)
    assert done.code == 0, done.stderr
    assert done.stderr.count(f" {code} ") == 1


def test_a_page_is_written_once(tmp_path: Path) -> None:
    page = tmp_path / "arm.html"
    done = animtool("report", CLIP, "-o", page)
    assert done.code == 0, done.stderr
    text = page.read_text("utf-8")
    assert text.count("<svg") == 2
    assert text.count("<iframe") == 1
    assert "http://" not in text.replace("http://www.w3.org/2000/svg", "")
    again = animtool("report", CLIP, "-o", page)
    assert (again.code, "OUT001" in again.stderr) == (2, True)


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        ((), 2, "--suite"),
        ((CLIP, "--suite"), 2, "--suite"),
        ((CLIP, "-o", "a.png"), 2, "a.html"),
        (("none.bvh",), 3, "IO001"),
        ((CLIP, "-o", "no/folder.html"), 3, "OUT002"),
    ],
)
def test_what_makes_no_sense_is_refused(
    words: tuple[str | Path, ...], code: int, said: str, tmp_path: Path
) -> None:
    done = animtool("report", *words, cwd=tmp_path)
    assert done.code == code
    assert said in done.stderr
