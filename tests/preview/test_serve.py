from __future__ import annotations

import http.client
import json
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from support.bvh import random_rows, small_bvh

from animtool.core.errors import AnimtoolError
from animtool.preview.build import PreviewPage, make_page
from animtool.preview.options import PreviewOptions
from animtool.preview.serve import ADDRESS, PageServer, WatchedPage, rebuild_on_changes

PLAIN = PreviewOptions(findings=False)


@pytest.fixture
def take(tmp_path: Path) -> Path:
    path = tmp_path / "take.bvh"
    path.write_text(small_bvh(random_rows(3)))
    return path


@contextmanager
def served(watched: WatchedPage) -> Iterator[PageServer]:
    with PageServer(watched) as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.01,))
        thread.start()
        try:
            yield server
        finally:
            server.shutdown()
            thread.join()


def asked(
    server: PageServer, path: str, method: str = "GET", **headers: str
) -> tuple[int, bytes, dict[str, str]]:
    port = server.server_address[1]
    client = http.client.HTTPConnection(ADDRESS, port, timeout=60)
    client.request(method, path, headers=headers)
    response = client.getresponse()
    found = response.status, response.read(), dict(response.headers)
    client.close()
    return found


def test_those_who_know_the_address_alone_get_the_page(take: Path) -> None:
    watched = WatchedPage(lambda: make_page([take], PLAIN))
    watched.build()
    with served(watched) as server:
        assert server.server_address[0] == ADDRESS
        secret = watched.secret
        assert len(secret) >= 20
        code, body, headers = asked(server, f"/{secret}/")
        assert (code, b"connect-src 'self'" in body) == (200, True)
        assert headers["Cache-Control"] == "no-store"
        assert headers["Referrer-Policy"] == "no-referrer"
        assert secret.encode() in body
        code, body, _ = asked(server, f"/{secret}/state")
        assert (code, json.loads(body)) == (200, {"version": 1, "error": None})
        for path in ("/", "/state", "//", f"/{secret[:-1]}/", f"/{secret}/../x",
                     f"/{secret}/take.bvh", f"/x/{secret}/"):  # fmt: skip
            code, body, _ = asked(server, path)
            assert (code, secret.encode() in body) == (403, False), path
        for name in ("evil.example", f"evil.example:{server.server_address[1]}", ""):
            assert asked(server, f"/{secret}/", Host=name)[0] == 403
        assert asked(server, f"/{secret}/", Origin="http://evil.example")[0] == 403
        assert asked(server, f"/{secret}/", method="POST")[0] == 501


def test_a_page_is_made_again_when_its_file_changes(take: Path) -> None:
    watched = WatchedPage(lambda: make_page([take], PLAIN))
    watched.build()
    assert not watched.has_changed()
    failures: list[AnimtoolError] = []
    pages: list[PreviewPage] = []
    texts = ["HIERARCHY\nnonsense", small_bvh(random_rows(5))]

    def wait(_: float) -> bool:
        if not texts:
            return True
        take.write_text(texts.pop(0))
        return False

    rebuild_on_changes(watched, failures.append, pages.append, wait)
    assert [error.code[:3] for error in failures] == ["BVH"]
    assert len(pages) == 1
    assert (watched.version, watched.error) == (2, None)
    assert pages[0].manifest["time"]["count"] == 5
    assert not watched.has_changed()


def test_an_error_stays_on_the_page_until_it_is_mended(take: Path) -> None:
    watched = WatchedPage(lambda: make_page([take], PLAIN))
    watched.build()
    before = watched.response_body()
    take.write_text("HIERARCHY\nnonsense")
    with pytest.raises(AnimtoolError):
        watched.build()
    state = json.loads(watched.polled_state())
    assert state["version"] == 1
    assert "BVH" in state["error"]
    assert watched.response_body() == before
    assert not watched.has_changed()
    take.unlink()
    assert watched.has_changed()


def test_files_that_a_file_names_are_followed(tmp_path: Path) -> None:
    rig = tmp_path / "r.rig.yaml"
    rig.write_text("rig: animtool/1\nname: r\njoints:\n- {name: a, type: free}\n")
    clip = tmp_path / "c.clip.yaml"
    head = "clip: animtool/1\nrig: r.rig.yaml\nfps: 24\nrange: [1, 2]\nchannels: []\n"
    clip.write_text(head)
    watched = WatchedPage(lambda: make_page([clip]))
    watched.build()
    rig.write_text(rig.read_text() + "- {name: b, parent: a, type: ball}\n")
    assert watched.has_changed()
    watched.build()
    assert watched.page is not None
    names = watched.page.manifest["takes"][0]["skeleton"]["names"]
    assert names == ["a", "b"]
