from __future__ import annotations

import html
import re
from pathlib import Path

import pytest
from preview.pages import ReadPage
from support.small_takes import small

import animtool
from animtool.core.errors import AnimtoolError
from animtool.preview.page import compact_code, json_text, viewer_modules
from animtool.preview.show import show


def test_a_notebook_shows_a_take_in_a_frame_of_its_own() -> None:
    shown = animtool.show(small(), height=300)
    text = shown._repr_html_()
    assert re.match(r'<iframe sandbox="allow-scripts" title="', text)
    assert "height:300px" in text
    inner = html.unescape(text.split('srcdoc="')[1].split('"')[0])
    assert inner == shown.page.html()
    assert ReadPage(inner).manifest["time"]["count"] == len(small())


def test_files_are_shown_and_saved(walk: Path, tmp_path: Path) -> None:
    path = show(walk).save(tmp_path / "walk.html")
    assert ReadPage(path.read_text("utf-8")).manifest["title"] == walk.name
    with pytest.raises(AnimtoolError) as caught:
        show(walk).save(path)
    assert caught.value.code == "OUT001"


def test_modules_follow_those_that_they_import() -> None:
    modules = viewer_modules()
    assert next(reversed(modules)) == "main.js"
    names = list(modules)
    for name, text in modules.items():
        for other in re.findall(r"""from\s*['"]\./([\w-]+\.js)['"]""", text):
            assert names.index(other) < names.index(name)
    assert "</script" not in "".join(modules.values())
    assert sum(len(text.encode()) for text in modules.values()) < 120_000


def test_json_has_no_letter_that_ends_a_script() -> None:
    text = json_text({"a": "<!--</script>\u2028\u2029&\ud800"})
    assert not set(text) & set("<>&\u2028\u2029\ud800")
    assert compact_code("a /* kept */\n  /* b\n c */\n  d // kept\n") == (
        "a /* kept */\nd // kept\n"
    )
