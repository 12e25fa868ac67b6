"""Pages of files, as they are written, in a headless Chromium."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from support.browser import READY, Browser
from support.bvh import random_rows, small_bvh

from animtool import read_bvh
from animtool.core.errors import AnimtoolError
from animtool.core.units import UpAxis
from animtool.motion.reorient import reorient
from animtool.preview.build import make_page, write_page
from animtool.preview.options import PreviewOptions
from animtool.preview.serve import ADDRESS, PageServer, WatchedPage
from animtool.scene.sources.open import SourceOptions

pytestmark = pytest.mark.slow(seconds=25)

PLAIN = PreviewOptions(findings=False)
ROOT = Path(__file__).parents[3]
FILES = sorted(
    path.relative_to(ROOT)
    for pattern in ("samples/*/*.clip.yaml", "rigs/*/*.rig.yaml")
    for path in ROOT.glob(pattern)
)


@pytest.mark.parametrize("file", FILES, ids=lambda path: path.name)
def test_pages_of_samples_draw(tmp_path: Path, browser: Browser, file: Path) -> None:
    page = tmp_path / "page.html"
    write_page([ROOT / file], page, PLAIN)
    with browser.open(page, size=(960, 600)) as opened:
        opened.bare()
        assert opened.covered().sum() > 20
        opened.page.keyboard.press("End")
        assert opened.covered().sum() > 20


@pytest.mark.parametrize("up", [UpAxis.Y, UpAxis.Z])
def test_a_capture_is_drawn_where_it_is(
    walk: Path, tmp_path: Path, browser: Browser, up: UpAxis
) -> None:
    page = tmp_path / "page.html"
    write_page(
        [walk], page, PreviewOptions(source=SourceOptions(up=up), findings=False)
    )
    take = reorient(read_bvh(walk, up=up), UpAxis.Y).collect()
    positions = take.world().positions
    with browser.open(page) as opened:
        opened.bare()
        for frame in (0, len(take) // 2, len(take) - 1):
            opened.seek(1 + frame)
            joints = opened.project(positions[frame])
            told = [opened.run(f"animtool.project(0, {j})") for j in range(len(joints))]
            assert_allclose(told, joints, atol=0.3)
            shown = opened.covered()
            seen = [shown[y, x] for x, y in np.rint(joints).astype(int)]
            assert np.mean(seen) > 0.9


@contextmanager
def served(watched: WatchedPage) -> Iterator[str]:
    with PageServer(watched) as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.01,))
        thread.start()
        try:
            yield f"http://{ADDRESS}:{server.server_address[1]}/{watched.secret}/"
        finally:
            server.shutdown()
            thread.join()


def test_a_served_page_shows_what_changed(tmp_path: Path, browser: Browser) -> None:
    path = tmp_path / "take.bvh"
    path.write_text(small_bvh(random_rows(3)))
    watched = WatchedPage(lambda: make_page([path], PLAIN))
    watched.build()
    with served(watched) as address, browser.visit(address + "#f=2") as opened:
        assert opened.frame == 2
        path.write_text(small_bvh(random_rows(5)))
        with opened.page.expect_event("load"):
            watched.build()
        opened.run(READY)
        assert opened.frame == 2
        assert opened.page.inner_text("#last-frame") == "/ 5"
        path.write_text("HIERARCHY nothing")
        with pytest.raises(AnimtoolError):
            watched.build()
        opened.page.locator("#failed").wait_for(state="visible")
        path.write_text(small_bvh(random_rows(4)))
        with opened.page.expect_event("load"):
            watched.build()
