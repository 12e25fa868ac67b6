"""How pages save time and memory: crowds as bones, hidden takes, decoded blocks."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from support.browser import Browser
from support.preview_pages import Chain, PageDraft, ribbon

from animtool.preview.streams import QuantizedValues

pytestmark = pytest.mark.slow(seconds=8)


def test_a_crowd_is_drawn_as_bones_or_with_its_meshes(
    tmp_path: Path, browser: Browser
) -> None:
    draft = PageDraft()
    for i in range(6):
        draft.take(Chain.swaying(phase=i), f"agent {i}", offset=[i, 0, 0])
        ribbon(draft, Chain.swaying(phase=i), i)
    with browser.open(draft.write(tmp_path / "crowd.html")) as opened:
        note = opened.page.locator("#simple")
        assert note.is_visible()
        opened.page.keyboard.press("0")
        reds = []
        for simple in (False, True):
            assert opened.run("animtool.app.scene.simple") is simple
            picture = opened.picture()
            red = picture[..., 0] - picture[..., 1:].max(axis=-1) > 0.3
            reds.append(int(red.sum()))
            opened.page.keyboard.press("m")
        assert reds[0] > 500
        assert reds[1] < reds[0] / 2
        assert opened.run("animtool.app.scene.simple") is False
        note.click()
        assert opened.run("animtool.app.scene.simple") is True


def test_what_is_hidden_is_not_drawn(tmp_path: Path, browser: Browser) -> None:
    draft, chain = PageDraft(), Chain.swaying()
    seen = (np.arange(48) < 10).astype("<u1")[:, None]
    draft.take(chain, visible=draft.packer.add(QuantizedValues(seen, "u8")))
    ribbon(draft, chain)
    with browser.open(draft.write(tmp_path / "hidden.html")) as opened:
        opened.bare()
        assert opened.covered().sum() > 200
        opened.page.keyboard.press("End")
        assert opened.covered().sum() == 0


def test_decoded_blocks_stay_within_their_limit(
    tmp_path: Path, browser: Browser
) -> None:
    frames, limit = 20_000, 100_000
    chain = Chain.swaying(frames)
    draft = PageDraft(frames)
    draft.take(chain)
    _, positions = chain.world()
    with browser.open(draft.write(tmp_path / "long.html")) as opened:
        opened.run(f"animtool.app.streams.most = {limit}")
        opened.seek(1001 + 1500)
        for frame in range(0, frames, 1000):
            opened.seek(1001 + frame)
            assert opened.run("animtool.app.streams.size") <= limit
        for frame in (0, frames - 1):
            opened.seek(1001 + frame)
            told = [opened.run(f"animtool.project(0, {j})") for j in range(6)]
            assert_allclose(told, opened.project(positions[frame]), atol=0.3)
