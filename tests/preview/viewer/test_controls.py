"""What pages do when they are used: keys, pointer, panels, addresses."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from support.browser import Browser, Opened
from support.preview_pages import Chain, PageDraft

pytestmark = pytest.mark.slow(seconds=12)

NASTY = [
    "</script><script>window.hacked=1</script>",
    '"><img src=x onerror="window.hacked=1">',
    "\u202egnp.exe\u202c\u2066\u2067",
    "🦴👩‍🚀 \ud83d",
    "x" * 10_000,
    "",
]


def page(path: Path, frames: int = 48, **more: object) -> Path:
    draft = PageDraft(frames)
    draft.take(Chain.swaying(frames), **more)
    values = np.stack([np.arange(frames) * 0.5, np.ones(frames)], axis=1)
    draft.channels(["joint/joint2.rotation.x", "control/grin"], values, take=0)
    for frame, joint in ((1010, "joint4"), (None, None), (1030, "joint1")):
        draft.add(
            "findings",
            code="TAKE001",
            severity="warning",
            message="jumps",
            frame=frame,
            joint=joint,
            take=0,
        )
    return draft.write(path)


def pressed(opened: Opened, name: str) -> bool:
    return bool(opened.page.locator(name).get_attribute("aria-pressed") == "true")


def test_keys(tmp_path: Path, browser: Browser) -> None:
    with browser.open(page(tmp_path / "a.html")) as opened:
        press = opened.page.keyboard.press
        for key, frame in (
            ("End", 1048),
            ("ArrowLeft", 1047),
            ("Home", 1001),
            ("ArrowLeft", 1001),
            ("ArrowRight", 1002),
        ):
            press(key)
            assert opened.frame == frame
        play = opened.page.locator("#play")
        press(" ")
        assert play.get_attribute("aria-label") == "Pause"
        opened.run(
            "async () => { const at = animtool.frame(); while (animtool.frame() === at)"
            " await new Promise((next) => setTimeout(next, 5)) }"
        )
        press(" ")
        assert play.get_attribute("aria-label") == "Play"
        assert 1002 < opened.frame < 1048
        press("ArrowUp")
        assert opened.page.locator("#speed").input_value() == "2"
        for key, name in (("l", "#loop"), ("f", "#follow")):
            before = pressed(opened, name)
            press(key)
            assert pressed(opened, name) is not before
        for key, axis in (("1", 2), ("3", 0), ("7", 1)):
            press(key)
            opened.drawn()
            view = np.reshape(opened.run("animtool.camera().view"), (4, 4)).T
            assert_allclose(view[2, axis], 1, atol=2e-3)
        press("?")
        assert opened.page.locator("#help").is_visible()
        press("Escape")
        assert not opened.page.locator("#help").is_visible()


def test_scrubbing(tmp_path: Path, browser: Browser) -> None:
    with browser.open(page(tmp_path / "a.html")) as opened:
        box = opened.page.locator("#scrub").bounding_box()
        mouse = opened.page.mouse
        mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
        mouse.down()
        assert opened.frame == pytest.approx(1024.5, abs=1)
        mouse.move(box["x"] + box["width"], box["y"] + 5)
        assert opened.frame == 1048
        mouse.up()
        opened.page.fill("#frame", "1012")
        opened.page.keyboard.press("Enter")
        assert opened.frame == 1012
        chart = opened.page.locator("#chart").bounding_box()
        mouse.click(chart["x"] + 46, chart["y"] + 60)
        assert opened.frame == 1001


def test_the_chart_zooms_and_pans_in_time(tmp_path: Path, browser: Browser) -> None:
    seen = "[animtool.app.curves.from, animtool.app.curves.to]"
    with browser.open(page(tmp_path / "a.html")) as opened:
        mouse, keys = opened.page.mouse, opened.page.keyboard
        chart = opened.page.locator("#chart").bounding_box()
        middle = chart["x"] + 46 + (chart["width"] - 58) / 2
        assert opened.run(seen) == [0, 47]
        mouse.move(middle, chart["y"] + 60)
        mouse.wheel(0, -200)
        opened.drawn()
        first, last = opened.run(seen)
        assert last - first < 40
        assert (first + last) / 2 == pytest.approx(23.5, abs=0.2)
        mouse.click(chart["x"] + 46, chart["y"] + 60)
        assert opened.frame == 1001 + round(first)
        mouse.move(middle, chart["y"] + 60)
        keys.down("Shift")
        mouse.down()
        mouse.move(middle - 60, chart["y"] + 60, steps=4)
        mouse.up()
        keys.up("Shift")
        moved = opened.run(seen)
        assert moved[0] > first
        assert moved[1] - moved[0] == pytest.approx(last - first)
        assert opened.frame == 1001 + round(first)
        mouse.dblclick(middle, chart["y"] + 60)
        assert opened.run(seen) == [0, 47]


def test_orbit_pan_and_zoom(tmp_path: Path, browser: Browser) -> None:
    with browser.open(page(tmp_path / "a.html")) as opened:
        mouse = opened.page.mouse

        def drag(dx: int, dy: int, button: str) -> np.ndarray:
            mouse.move(400, 300)
            mouse.down(button=button)
            mouse.move(400 + dx, 300 + dy, steps=3)
            mouse.up(button=button)
            opened.drawn()
            return np.reshape(opened.run("animtool.camera().view"), (4, 4)).T

        first = drag(0, 0, "left")
        turned = drag(80, 0, "left")
        assert np.abs(turned[:3, :3] - first[:3, :3]).max() > 0.3
        before = opened.run("animtool.project(0, 0)")
        panned = drag(50, 30, "right")
        assert_allclose(panned[:3, :3], turned[:3, :3], atol=1e-6)
        after = opened.run("animtool.project(0, 0)")
        assert_allclose(np.subtract(after, before), [50, 30], atol=4)
        mouse.wheel(0, -200)
        opened.drawn()
        view = np.reshape(opened.run("animtool.camera().view"), (4, 4)).T
        assert np.abs(view[2, 3]) < np.abs(panned[2, 3])


def test_a_click_selects_a_joint_and_its_channels(
    tmp_path: Path, browser: Browser
) -> None:
    with browser.open(page(tmp_path / "a.html")) as opened:
        opened.seek(1005)  # where it stays, while it is looked for and clicked on
        opened.page.mouse.click(*opened.run("animtool.project(0, 2)"))
        opened.drawn()
        assert opened.page.inner_text("#readout bdi") == "joint2"
        assert "joint/joint2.rotation.x" in opened.page.inner_text("#legend")
        assert "grin" not in opened.page.inner_text("#legend")


def test_findings_lead_to_frame_and_joint(tmp_path: Path, browser: Browser) -> None:
    path = page(tmp_path / "a.html")
    with browser.open(path) as opened:
        opened.page.click("#tab-findings")
        opened.page.click("#tab-findings")
        links = opened.page.locator(".finding")
        assert links.count() == 3
        links.nth(2).click()
        opened.drawn()
        assert opened.frame == 1030
        assert opened.page.inner_text("#readout bdi") == "joint1"
        opened.page.wait_for_timeout(250)
        fragment = opened.run("location.hash")
        assert "f=1030" in fragment
        assert "find=2" in fragment
        camera = opened.run("animtool.camera()")
    with browser.open(path, fragment=fragment) as opened:
        assert opened.frame == 1030
        assert opened.page.inner_text("#readout bdi") == "joint1"
        again = opened.run("animtool.camera()")
        assert_allclose(again["view"], camera["view"], atol=2e-3)


def test_a_fragment_pins_frame_and_camera(tmp_path: Path, browser: Browser) -> None:
    fragment = "#f=1012&cam=0.5,0.2,3.1,0,1,0&find=0"
    with browser.open(page(tmp_path / "a.html"), fragment=fragment) as opened:
        assert opened.frame == 1012
        view = np.reshape(opened.run("animtool.camera().view"), (4, 4)).T
        eye = np.linalg.inv(view)[:3, 3]
        level = 3.1 * np.cos(0.2)
        wanted = [level * np.sin(0.5), 1 + 3.1 * np.sin(0.2), level * np.cos(0.5)]
        assert_allclose(eye, wanted, atol=1e-3)
        assert opened.page.inner_text("#readout bdi") == "joint4"


def test_curves_follow_the_playhead(tmp_path: Path, browser: Browser) -> None:
    with browser.open(page(tmp_path / "a.html")) as opened:
        opened.seek(1021)
        legend = opened.page.inner_text("#legend")
        assert legend == "joint/joint2.rotation.x 10"
        opened.page.click("#tab-channels")
        opened.page.locator("#channels button", has_text="control/grin").click()
        assert "control/grin 1" in opened.page.inner_text("#legend")


def test_thousands_of_curves(tmp_path: Path, browser: Browser) -> None:
    draft = PageDraft(24)
    values = np.random.default_rng(1).normal(size=(24, 5000))
    draft.channels([f"control/c{i}" for i in range(5000)], values)
    with browser.open(draft.write(tmp_path / "a.html")) as opened:
        names = opened.page.locator("#channels button")
        assert names.count() == 200
        assert "5000" in opened.page.inner_text("#channels-note")
        opened.page.fill("#filter", "c4321")
        assert names.count() == 1
        names.first.click()
        opened.seek(1010)
        legend = opened.page.inner_text("#legend")
        assert f"control/c4321 {values[9, 4321]:.3f}".rstrip("0") in legend


def test_takes_are_compared(tmp_path: Path, browser: Browser) -> None:
    one = Chain.swaying()
    other = Chain(one.names, one.translations.copy(), one.rotations)
    other.translations[:, 3, 0] += 0.02
    draft = PageDraft()
    draft.take(one, "first")
    draft.take(other, "second")
    with browser.open(draft.write(tmp_path / "a.html")) as opened:
        entries = opened.page.locator("#takes li")
        assert "up to 20 mm" in entries.nth(1).inner_text()
        apart = [opened.run(f"animtool.project({k}, 0)") for k in (0, 1)]
        assert_allclose(apart[0], apart[1], atol=0.5)
        opened.page.click("#heat")
        opened.page.click("#beside")
        opened.drawn()
        apart = [opened.run(f"animtool.project({k}, 0)") for k in (0, 1)]
        assert apart[1][0] - apart[0][0] > 40
        assert "up to 20 mm" in entries.nth(1).inner_text()
        assert opened.page.inner_text("#heat-most") == "20 mm"
        opened.page.locator("#takes input").nth(1).uncheck()
        opened.bare()
        hidden = opened.covered()
        x, y = (round(v) for v in opened.run("animtool.project(1, 2)"))
        assert not hidden[y - 4 : y + 4, x - 4 : x + 4].any()


def test_hostile_names_are_text(tmp_path: Path, browser: Browser) -> None:
    chain = Chain.swaying()
    for title in (NASTY[0], NASTY[3], NASTY[4]):
        draft = PageDraft(title=title)
        draft.take(Chain(NASTY, chain.translations, chain.rotations), title)
        draft.take(Chain(NASTY, chain.translations, chain.rotations), NASTY[0])
        draft.channels(NASTY, np.zeros((48, len(NASTY))))
        draft.add(
            "findings",
            code=title,
            severity=title,
            message=NASTY[0] + title,
            frame=1005,
            joint=NASTY[1],
            take=0,
        )
        with browser.open(draft.write(tmp_path / "a.html")) as opened:
            opened.page.click("#show-names")
            opened.page.click("#tab-takes")
            opened.page.locator(".finding").evaluate("(link) => link.click()")
            opened.drawn()
            assert opened.run("window.hacked") is None
            shown = opened.page.inner_text("h1")
            assert shown == title.encode("utf-8", "replace").decode().strip()
            wide = opened.run("document.documentElement.scrollWidth")
            assert wide <= 1280


@pytest.mark.parametrize("frames", [0, 1])
def test_pages_with_next_to_nothing(
    tmp_path: Path, browser: Browser, frames: int
) -> None:
    draft = PageDraft(1)
    if frames:
        draft.take(Chain.swaying(1))
        none = Chain([], np.zeros((1, 0, 3)), np.zeros((1, 0, 4)))
        draft.take(none, "empty")
    with browser.open(draft.write(tmp_path / "a.html")) as opened:
        for key in (" ", "End", "ArrowRight", "f", "1", "0"):
            opened.page.keyboard.press(key)
        opened.drawn()
        assert opened.frame == 1001


def test_a_fault_is_written_on_the_page(tmp_path: Path, browser: Browser) -> None:
    path = page(tmp_path / "a.html")
    text = path.read_text("utf-8").replace('"format":1', '"format":1,}')
    path.write_text(text, "utf-8")
    with browser.open(path, errors=True) as opened:
        assert opened.page.locator("#failed").is_visible()
        assert "JSON" in opened.page.inner_text("#failed")
