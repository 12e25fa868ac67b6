"""How pages look: widths, themes, names that screen readers speak, and their sizes."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from support.browser import Browser
from support.preview_pages import Chain, PageDraft

from animtool.preview.page import VIEWER_FOLDER, page_parts

TSC = shutil.which("tsc")


def full(path: Path) -> Path:
    """Write a page with something of everything that has a button."""
    draft = PageDraft(title="a_rather_long_name_of_a_take_v012.clip.yaml")
    draft.take(Chain.swaying(speed=0.05), contacts=[{"joint": 0, "spans": [[1001, 9]]}])
    draft.take(Chain.swaying(phase=0.4), "other")
    draft.channels([f"control/c{i}" for i in range(40)], np.zeros((48, 40)))
    draft.add(
        "cameras",
        name="main",
        t=draft.packer.add_static(np.array([0, 1.0, 5]), "f32"),
        r=draft.packer.add_static(np.array([0, 0, 0, 1.0]), "f32"),
        focal_mm=35.0,
        focal=None,
        aperture_mm=[36.0, 24.0],
    )
    for i in range(30):
        draft.add(
            "findings",
            code=f"TAKE{i:03}",
            severity=("error", "warning", "note")[i % 3],
            message="The joint turns by 193 degrees from one frame to the next.",
            frame=1001 + i,
            joint="joint3",
            take=0,
        )
    return draft.write(path)


@pytest.mark.slow(seconds=8)
@pytest.mark.parametrize("size", [(360, 640), (390, 844), (768, 1024), (1280, 720)])
def test_every_control_is_in_reach(
    tmp_path: Path, browser: Browser, size: tuple[int, int]
) -> None:
    with browser.open(full(tmp_path / "a.html"), size=size) as opened:
        for tab in ("findings", "takes", "channels"):
            if opened.page.locator(f"#panel-{tab}").is_hidden():
                opened.page.click(f"#tab-{tab}")
            opened.drawn()
            width, height = opened.run(
                "[document.documentElement.scrollWidth,"
                " document.documentElement.scrollHeight]"
            )
            assert (width, height) <= size
            view = opened.page.locator("#view").bounding_box()
            assert view["height"] >= 120
            for control in opened.page.locator(
                "nav button, footer :is(button, input)"
            ).all():
                box = control.bounding_box()
                assert box["x"] >= 0
                assert box["y"] >= 0
                assert box["x"] + box["width"] <= size[0]
                assert box["y"] + box["height"] <= size[1]
                assert min(box["width"], box["height"]) >= 24


@pytest.mark.slow(seconds=3)
def test_every_control_has_a_name(tmp_path: Path, browser: Browser) -> None:
    with browser.open(full(tmp_path / "a.html")) as opened:
        nameless = opened.run(
            "[...document.querySelectorAll('button, input, select, canvas')]"
            ".filter((e) => !e.closest('[aria-hidden]'))"
            ".filter((e) => !(e.ariaLabel || e.textContent.trim()"
            " || e.labels?.[0]?.textContent.trim())).map((e) => e.outerHTML)"
        )
        assert nameless == []


@pytest.mark.slow(seconds=3)
def test_the_theme_is_the_systems_until_it_is_chosen(
    tmp_path: Path, browser: Browser
) -> None:
    for scheme, other in (("light", "dark"), ("dark", "light")):
        with browser.open(full(tmp_path / "a.html"), scheme=scheme) as opened:
            theme = "document.documentElement.dataset.theme"
            assert opened.run(theme) == scheme
            before = opened.picture().mean()
            opened.page.click("#theme")
            assert opened.run(theme) == other
            assert abs(opened.picture().mean() - before) > 0.3


def themes() -> list[dict[str, str]]:
    text = (VIEWER_FOLDER / "viewer.css").read_text("utf-8")
    light, dark = (
        dict(re.findall(r"--([\w-]+): (#\w{6})", block))
        for block in re.findall(r":root[^{]*\{([^}]*)\}", text)[:2]
    )
    return [light, light | dark]


def luminance(color: str) -> float:
    parts = [int(color[i : i + 2], 16) / 255 for i in (1, 3, 5)]
    linear = [
        c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in parts
    ]
    return float(np.dot(linear, [0.2126, 0.7152, 0.0722]))


@pytest.mark.parametrize("theme", themes(), ids=["light", "dark"])
def test_text_has_contrast(theme: dict[str, str]) -> None:
    for ground, inks in {
        "panel": ("ink", "soft", "accent", "error", "warning"),
        "view": ("ink", "soft"),
        "on": ("accent", "ink"),
        "hover": ("ink", "soft"),
        "fault": ("error",),
    }.items():
        for ink in inks:
            dark, light = sorted(map(luminance, (theme[ink], theme[ground])))
            assert (light + 0.05) / (dark + 0.05) >= 4.5, (ink, ground)


def test_the_viewer_is_small() -> None:
    nothing = b"".join(page_parts({"format": 1, "title": ""}, []))
    assert len(nothing) <= 70_000
    for module in VIEWER_FOLDER.glob("*.js"):
        assert module.read_text("utf-8").count("\n") <= 300, module.name


@pytest.mark.slow(seconds=6)
@pytest.mark.skipif(TSC is None, reason="tsc is not installed: npm install typescript")
def test_the_viewer_is_typed() -> None:
    assert TSC is not None
    project = Path(__file__).with_name("tsconfig.json")
    done = subprocess.run(
        [TSC, "-p", project], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout
