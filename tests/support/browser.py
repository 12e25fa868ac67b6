"""Pages in a headless Chromium: what they ask for, say and show."""

from __future__ import annotations

import io
import shutil
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import matplotlib.image
import numpy as np
import numpy.typing as npt
import pytest

Array = npt.NDArray[Any]
# Chromium draws with its own rasteriser: tests need no graphics processor.
ARGUMENTS = (
    "--no-sandbox",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--force-color-profile=srgb",
)
CHROMIUM = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))),
    None,
)
# Until main.js is evaluated there is no `ready`; the page's policy forbids `eval`,
# which waiting for an expression needs.
READY = """async () => {
  while (!window.animtool?.ready && !window.animtool?.errors?.length) {
    await new Promise((resolve) => setTimeout(resolve, 5));
  }
  await window.animtool.ready?.catch(() => undefined);
  return window.animtool.errors;
}"""


@dataclass
class Opened:
    """A page, and what it did so far."""

    page: Any
    said: list[str] = field(default_factory=list)
    requests: list[str] = field(default_factory=list)

    def run(self, script: str, *arguments: Any) -> Any:
        return self.page.evaluate(script, *arguments)

    @property
    def frame(self) -> float:
        return float(self.run("animtool.frame()"))

    def seek(self, frame: float) -> None:
        self.run("(frame) => animtool.seek(frame)", frame)

    def drawn(self) -> None:
        """Wait for two pictures."""
        self.run(
            "() => new Promise((done) => requestAnimationFrame("
            "() => requestAnimationFrame(() => setTimeout(done, 30))))"
        )

    def matrices(self) -> Array:
        """Return projection · view."""
        found = self.run("animtool.camera()")
        view, projection = (
            np.reshape(found[name], (4, 4)).T for name in ("view", "projection")
        )
        return np.asarray(projection @ view)

    def project(self, points: Array) -> Array:
        """Return where points of the world are in the window [px]."""
        box = self.page.locator("#view").bounding_box()
        clip = np.concatenate([points, np.ones((*points.shape[:-1], 1))], -1)
        clip = clip @ self.matrices().T
        flat = clip[..., :2] / clip[..., 3:]
        flat = (flat * [1, -1] + 1) / 2 * [box["width"], box["height"]]
        return np.asarray(flat + np.array([box["x"], box["y"]]))

    def picture(self) -> Array:
        """Return the window's pixels ``(H, W, 3)``, 0 to 1."""
        self.drawn()

        pixels = matplotlib.image.imread(io.BytesIO(self.page.screenshot()), "png")
        return np.asarray(pixels[..., :3])

    def bare(self) -> None:
        """Hide all that is drawn over the scene, and the ground."""
        self.page.add_style_tag(
            content=".bar, #note, #readout, #labels, #axes { visibility: hidden; }"
        )
        for name in ("grid", "trails", "contacts"):
            self.page.locator(f"#show-{name}").evaluate(
                "(b) => { if (!b.hidden && b.ariaPressed === 'true') b.click() }"
            )

    def covered(self) -> Array:
        """Return which pixels of the window show more than the background."""
        box = {k: int(v) for k, v in self.page.locator("#view").bounding_box().items()}
        pixels = self.picture()
        ground = pixels[box["y"] + 3, box["x"] + 3]
        shown = np.abs(pixels - ground).max(axis=-1) > 0.04
        inside = np.zeros_like(shown)
        inside[
            box["y"] + 2 : box["y"] + box["height"] - 2,
            box["x"] + 2 : box["x"] + box["width"] - 2,
        ] = True
        return shown & inside


class Browser:
    """A Chromium that opens pages from disk."""

    def __init__(self, chromium: Any) -> None:
        self._chromium = chromium

    @contextmanager
    def blank(self) -> Iterator[Any]:
        """Give a page that shows nothing yet."""
        context = self._chromium.new_context()
        try:
            yield context.new_page()
        finally:
            context.close()

    def open(
        self,
        path: Path,
        *,
        size: tuple[int, int] = (1280, 720),
        scheme: str = "light",
        fragment: str = "",
        errors: bool = False,
    ) -> AbstractContextManager[Opened]:
        """Open a page; at its end it must have asked for nothing and said nothing."""
        return self.visit(
            path.as_uri() + fragment, size=size, scheme=scheme, errors=errors
        )

    @contextmanager
    def visit(
        self,
        address: str,
        *,
        size: tuple[int, int] = (1280, 720),
        scheme: str = "light",
        errors: bool = False,
    ) -> Iterator[Opened]:
        """Open an address; what is asked for must be below it."""
        context = self._chromium.new_context(
            viewport={"width": size[0], "height": size[1]}, color_scheme=scheme
        )
        opened = Opened(context.new_page())
        opened.page.on("console", lambda m: opened.said.append(f"{m.type}: {m.text}"))
        opened.page.on("pageerror", lambda e: opened.said.append(str(e)))
        opened.page.on("dialog", lambda d: (opened.said.append("dialog"), d.dismiss()))
        opened.page.on("request", lambda r: opened.requests.append(r.url))
        try:
            opened.page.goto(address)
            faults = opened.run(READY)
            assert errors or faults == []
            yield opened
            own = "blob:", address.partition("#")[0]
            assert [u for u in opened.requests if not u.startswith(own)] == []
            assert errors or opened.said == []
            assert errors or opened.run("animtool.errors") == []
        finally:
            context.close()


@contextmanager
def chromium() -> Iterator[Browser]:
    """Start Chromium, or skip where it or its driver is missing."""
    if CHROMIUM is None:
        pytest.skip("chromium is not installed")
    driver = pytest.importorskip(
        "playwright.sync_api", reason="playwright is not installed"
    )
    with driver.sync_playwright() as playwright:
        running = playwright.chromium.launch(
            executable_path=CHROMIUM, args=[*ARGUMENTS]
        )
        try:
            yield Browser(running)
        finally:
            running.close()
