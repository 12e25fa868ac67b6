"""Pages of time against error, with two settings that play beside each other."""

from __future__ import annotations

from pathlib import Path

import pytest
from support.browser import READY, Browser

from animtool.preview.tradeoff_page import write_tradeoff_page
from animtool.scene.tables.tradeoffs import SUITE_FOLDER, measure_tradeoffs


@pytest.mark.slow(seconds=6)
def test_two_settings_play_together(browser: Browser, tmp_path: Path) -> None:
    source = SUITE_FOLDER / "arm.clip.yaml"
    report = measure_tradeoffs(source, budget=2e-3, folder=tmp_path)
    output = tmp_path / "arm.html"
    write_tradeoff_page(report, output)
    said: list[str] = []
    with browser.blank() as page:
        page.on("console", lambda message: said.append(message.text))
        page.on("pageerror", lambda error: said.append(str(error)))
        page.goto(output.as_uri())
        assert page.locator("svg[role=img]").count() == 2
        viewer = page.frames[1]
        assert viewer.evaluate(READY) == []
        # A frame on, the address would be written, which a frame has none of.
        viewer.locator("#view").press("ArrowRight")
        viewer.evaluate("() => new Promise((done) => setTimeout(done, 200))")
        assert viewer.locator("#beside").get_attribute("aria-pressed") == "true"
        frames = viewer.evaluate("animtool.frame()")
    assert said == []
    assert frames == 2
    # The arm is .7 m long at first, with points 3 cm off it.
    (pair,) = report.stage_pairs
    assert pair.size == pytest.approx(0.7, abs=0.1)
