"""Tutorials work as they are written, and their pictures are what they draw."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from support.drawing import can_draw
from support.tutorials import (
    DOCS,
    TUTORIALS,
    Step,
    follow,
    pictures_of,
    steps_of,
    workplace_of,
)

# Mean difference of a channel, of 255: rasterisers differ at edges.
SAME = 2.0
MAX_BYTES = 100_000
DRAWS = re.compile(r"animtool preview .* -o \S+\.webp\b")


def pixels(path: Path) -> np.ndarray:
    from PIL import Image

    with Image.open(path) as image:
        return np.asarray(image.convert("RGB"), np.float64)


def test_there_are_tutorials() -> None:
    assert {page.stem for page in TUTORIALS} >= {"desk-lamp", "capture"}


def test_steps_are_files_and_commands_in_order() -> None:
    text = (
        'Write:\n\n```yaml title="a/b.rig.yaml"\nrig: animtool/1\n```\n\nRun:\n\n'
        "```console\n$ animtool info a/b.rig.yaml\n$ animtool bake b -o c.usdc\n```\n"
        "```yaml\nnot: a step\n```\n"
    )
    steps = list(steps_of(text))
    assert steps == [
        Step("rig: animtool/1\n", "a/b.rig.yaml"),
        Step("animtool info a/b.rig.yaml"),
        Step("animtool bake b -o c.usdc"),
    ]
    assert [step.output for step in steps[1:]] == ["", "c.usdc"]


@pytest.mark.parametrize("page", TUTORIALS, ids=lambda page: page.stem)
def test_each_picture_is_drawn_by_a_command_of_the_page(page: Path) -> None:
    text = page.read_text("utf-8")
    drawn = {Path(step.output).name for step in steps_of(text) if not step.file}
    pictures = pictures_of(text)
    assert pictures
    for picture in pictures:
        assert Path(picture).name in drawn
        assert 0 < (page.parent / picture).stat().st_size < MAX_BYTES
    kept = set((page.parent / page.stem).iterdir())
    assert kept == {page.parent / picture for picture in pictures}


@pytest.mark.slow(seconds=4)
@pytest.mark.parametrize("page", TUTORIALS, ids=lambda page: page.stem)
def test_it_can_be_followed(page: Path, tmp_path: Path) -> None:
    text, place, drawing = page.read_text("utf-8"), workplace_of(page, tmp_path), True
    for step in steps_of(text):
        if not step.file and DRAWS.match(step.text):
            drawing = drawing and can_draw()
            if not drawing:
                continue
        follow(step, place)
        assert not step.output or (place / step.output).exists() or "{" in step.output
    if not drawing:
        pytest.skip("followed, but no pictures can be drawn")
    outputs = {Path(s.output).name: place / s.output for s in steps_of(text)}
    for picture in pictures_of(text):
        found = pixels(outputs[Path(picture).name])
        kept = pixels(page.parent / picture)
        assert found.shape == kept.shape
        assert np.abs(found - kept).mean() < SAME, picture


@pytest.mark.parametrize("page", TUTORIALS, ids=lambda page: page.stem)
def test_its_files_are_named_by_its_commands_or_each_other(page: Path) -> None:
    text = page.read_text("utf-8")
    files = [step for step in steps_of(text) if step.file]
    others = "\n".join(step.text for step in steps_of(text))
    assert all(Path(step.file).name in others for step in files)
    assert DOCS in page.parents
