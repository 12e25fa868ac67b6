"""Draw what a preview page looks like, by chromium and playwright's Python package.

python samples/pictures/page.py
"""

from __future__ import annotations

import tempfile
from pathlib import Path

from playwright.sync_api import sync_playwright

from animtool.preview.build import write_page

HERE = Path(__file__).parent
CLIP = HERE.parent / "speech/speech.clip.yaml"
FRAME = 46
# Without a display, WebGL is drawn by the processor.
ARGUMENTS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]


def main() -> None:
    """Write the picture."""
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        page = Path(folder) / "speech.html"
        write_page([CLIP], page)
        browser = playwright.chromium.launch(
            executable_path="/usr/bin/chromium", args=ARGUMENTS
        )
        tab = browser.new_page(viewport={"width": 1280, "height": 720})
        tab.goto(page.as_uri())
        tab.evaluate("() => window.animtool.ready")
        tab.evaluate("frame => window.animtool.seek(frame)", FRAME)
        tab.screenshot(path=HERE / "page.png")
        browser.close()


if __name__ == "__main__":
    main()
