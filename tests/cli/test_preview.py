from __future__ import annotations

import json
import webbrowser
from pathlib import Path

import pytest
from support.cli import animtool

from animtool.preview import show


@pytest.fixture
def opened(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Return the addresses that a browser is asked for."""
    addresses: list[str] = []

    def take(address: str) -> bool:
        addresses.append(address)
        return True

    monkeypatch.setattr(webbrowser, "open", take)
    return addresses


@pytest.mark.parametrize("remote", [True, False])
def test_a_page_is_opened_where_somebody_sees_it(
    walk: Path, opened: list[str], monkeypatch: pytest.MonkeyPatch, *, remote: bool
) -> None:
    monkeypatch.setenv("DISPLAY", ":0")
    for name in ("SSH_CONNECTION", "SSH_TTY"):
        monkeypatch.delenv(name, raising=False)
    if remote:
        monkeypatch.setenv("SSH_CONNECTION", "10.0.0.1 1 10.0.0.2 22")
    monkeypatch.setattr(
        show.has_browser, "__defaults__", ({**show.os.environ}, "linux")
    )
    done = animtool("preview", walk)
    assert done.code == 0
    path = Path(done.stdout.strip() or opened[0].removeprefix("file://"))
    assert path.read_bytes().startswith(b"<!doctype html>")
    assert bool(opened) is not remote
    assert bool(done.stdout) is remote
    path.unlink()
    path.parent.rmdir()


def test_the_path_is_printed_where_nothing_is_to_be_opened(
    walk: Path, opened: list[str]
) -> None:
    done = animtool("preview", walk, "--no-open")
    assert (done.code, opened) == (0, [])
    path = Path(done.stdout.strip())
    assert path.is_file()
    path.unlink()
    path.parent.rmdir()


def test_a_page_is_written_once(walk: Path, tmp_path: Path, opened: list[str]) -> None:
    output = tmp_path / "walk.html"
    done = animtool("preview", walk, "-o", output, "--format", "json")
    report = json.loads(done.stdout)
    assert (done.code, opened) == (0, [])
    assert report["preview"] == "animtool/1"
    assert report["bytes"] == output.stat().st_size < 200_000
    assert (report["frames"], report["takes"], report["first"]) == (64, 1, 1)
    assert 0 < report["position_error_mm"] < 0.2
    again = animtool("preview", walk, "-o", output)
    assert again.code == 2
    assert "OUT001" in again.stderr
    assert "--skip-existing" not in again.stderr
    before = output.read_bytes()
    assert animtool("preview", walk, "-o", output, "--overwrite").code == 0
    assert output.read_bytes() == before
    assert animtool("preview", walk, "-o", walk, "--overwrite").code == 2


def test_what_makes_no_sense_is_usage(walk: Path, tmp_path: Path) -> None:
    over = animtool("preview", walk, "--over", "look.usda", "-o", tmp_path / "o.html")
    assert (over.code, "PRV006" in over.stderr) == (2, True)
    assert animtool("preview").code == 2
    assert animtool("preview", walk, "--watch", "-o", tmp_path / "o.html").code == 2
    assert animtool("preview", walk, "--range", "9-1").code == 2
    assert animtool("preview", tmp_path / "none.bvh", "--no-open").code == 3


def test_a_plan_writes_nothing(walk: Path, root: Path, tmp_path: Path) -> None:
    output = tmp_path / "walk.html"
    scene = root / "samples/rope/lantern.scene.yaml"
    done = animtool("preview", walk, scene, "--plan", "-o", output, "--format", "json")
    steps = json.loads(done.stdout)["steps"]
    assert (done.code, output.exists()) == (0, False)
    assert steps[0]["kind"] == "source"
    assert "64 frames" in " ".join(steps[0]["makes"])
    assert steps[-1]["kind"] == "output"
    assert steps[-1]["makes"] == [str(output)]
    assert any(step["kind"] == "system" for step in steps)
    assert animtool("preview", walk, "--plan", "--watch").code == 2
