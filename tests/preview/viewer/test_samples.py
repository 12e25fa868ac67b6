"""Pages of files, as the command writes them, in a headless Chromium."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from support.browser import Browser

from animtool.motion.take import TakeStream
from animtool.preview.build import write_page
from animtool.readers import open_take
from animtool.rig.kinematics import forward

pytestmark = pytest.mark.slow(seconds=20)

ROOT = Path(__file__).parents[3]
FILES = sorted(
    path.relative_to(ROOT)
    for pattern in ("samples/*/*.bvh", "samples/*/*.clip.yaml", "rigs/*/*.rig.yaml")
    for path in ROOT.glob(pattern)
)


@pytest.mark.parametrize("file", FILES, ids=lambda path: path.name)
def test_pages_of_samples_draw(tmp_path: Path, browser: Browser, file: Path) -> None:
    page = tmp_path / "page.html"
    write_page([ROOT / file], page)
    with browser.open(page, size=(960, 600)) as opened:
        opened.bare()
        assert opened.covered().sum() > 300
        opened.page.keyboard.press("End")
        assert opened.covered().sum() > 300
