"""Timelines of any content: what is wrong with them is said, and nothing else is."""

from __future__ import annotations

import json
import os
import zipfile
from pathlib import Path
from typing import Any

import pytest
from support.batch import take_files

from animtool.batch import timeline as texts
from animtool.batch.cut_frames import CutOptions
from animtool.batch.cuts import CutList, read_cut, read_cuts
from animtool.core.errors import AnimtoolError
from animtool.core.files.reading import MatchedFile

otio = pytest.importorskip("opentimelineio", reason="no OpenTimelineIO (extra: otio)")

from support.timelines import clip, timeline  # noqa: E402


@pytest.fixture
def takes(tmp_path: Path) -> Path:
    take_files(tmp_path / "takes", 1)
    return tmp_path


def whole(folder: Path, *names: str) -> Path:
    """Return a timeline of clips of these names."""
    clips = [clip(name, "takes/take000.bvh", (10, 12)) for name in names or ("a",)]
    return timeline(folder / "a.otio", *clips, rate=24)


def spoilt(folder: Path, kind: str, **values: object) -> Path:
    """Return a timeline with other values in each object of a kind."""
    path = whole(folder)

    def spoil(value: Any) -> None:
        inner = value.values() if isinstance(value, dict) else value
        if isinstance(value, dict) and str(value.get("OTIO_SCHEMA")).startswith(kind):
            value.update(values)
        if isinstance(value, dict | list):
            for part in inner:
                spoil(part)

    made = json.loads(path.read_text("utf-8"))
    spoil(made)
    path.write_text(json.dumps(made), "utf-8")
    return path


def code(path: Path) -> str:
    """Return why a timeline cannot be read."""
    with pytest.raises(AnimtoolError) as error:
        read_cuts(path)
    return error.value.code


DEEP = 100_000


@pytest.mark.parametrize(
    "text",
    [
        "",
        "\0" * 99,
        "[" * DEEP,
        "[" * DEEP + "]" * DEEP,
        '{"a":' * DEEP + "1" + "}" * DEEP,
        '{"OTIO_SCHEMA": "Timeline.1", "tracks": ' + "[" * DEEP,
        "7",
        '"a"',
        '{"OTIO_SCHEMA": 7}',
        "\ud800",
    ],
)
@pytest.mark.parametrize("suffix", [".otio", ".otioz", ".edl"])
def test_what_is_no_timeline(tmp_path: Path, text: str, suffix: str) -> None:
    path = tmp_path / f"a{suffix}"
    path.write_bytes(text.encode("utf-8", "surrogatepass"))
    if suffix == ".edl" and not text:
        assert read_cuts(path).shots == []
        return
    assert code(path) == "BAT041"


def test_a_timeline_that_is_cut_off_anywhere(takes: Path) -> None:
    path = whole(takes)
    data = path.read_bytes()
    # The library's own parser ends the process at some of these.
    for length in range(0, len(data) - 1, 97):
        path.write_bytes(data[:length])
        assert code(path) == "BAT041"


@pytest.mark.skipif(os.name == "nt", reason="POSIX pipes")
def test_a_pipe_is_no_timeline(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "a.otio")
    assert code(tmp_path / "a.otio") == "BAT041"
    assert code(tmp_path / "none.otio") == "BAT041"


def test_an_archive_that_unpacks_to_more_than_fits(
    takes: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    data = whole(takes).read_bytes()
    path = takes / "a.otioz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr("content.otio", data + b" " * 1_000_000)
        file.writestr("version.txt", "1.0.0")
    assert len(read_cuts(path).shots) == 1
    monkeypatch.setattr(texts, "MAX_TIMELINE_BYTES", 500_000)
    assert code(path) == "BAT041"


def test_a_timeline_without_tracks(takes: Path) -> None:
    assert code(spoilt(takes, "Timeline", tracks=None)) == "BAT041"


NUMBERS = [0, -24, 1e-9, 1e300, -1e300, float("nan"), float("inf"), -float("inf")]


@pytest.mark.parametrize("number", NUMBERS)
@pytest.mark.parametrize("key", ["rate", "value"])
def test_times_that_are_none(takes: Path, key: str, number: float) -> None:
    assert code(spoilt(takes, "RationalTime", **{key: number})) in {"BAT041", "BAT005"}


@pytest.mark.parametrize("rate", [1e-9, 1e300, float("inf")])
def test_a_global_start_time_at_no_rate(takes: Path, rate: float) -> None:
    time = {"OTIO_SCHEMA": "RationalTime.1", "rate": rate, "value": 0.0}
    assert code(spoilt(takes, "Timeline", global_start_time=time)) == "BAT041"


@pytest.mark.parametrize(
    ("speed", "found"),
    [(1e300, "BAT041"), (-1e9, "BAT041"), (1e308, "BAT041")],
)
def test_speeds_that_nothing_has(takes: Path, speed: float, found: str) -> None:
    made = clip("a", "takes/take000.bvh", (10, 12))
    for _ in range(25):
        made.effects.append(otio.schema.LinearTimeWarp(time_scalar=speed))
    assert code(timeline(takes / "a.otio", made)) == found


def test_a_speed_of_almost_nothing_holds_the_frame(takes: Path) -> None:
    made = clip("a", "takes/take000.bvh", (10, 12))
    made.effects.append(otio.schema.LinearTimeWarp(time_scalar=1e-300))
    (cut,) = read_cuts(timeline(takes / "a.otio", made)).shots
    assert cut.shot is not None
    assert cut.shot.speed == 0


URLS = [
    *("file://[", "http://[::1", "file://host/takes/take000.bvh", "//host/take000.bvh"),
    *("file:///%00", "%00", "a\0b", "/dev/zero", "..", ".", "/", "file:", "file://"),
    *("a" * 5000, "/" * 5000, "file:///" + "a" * 5000, "~/take000.bvh", "C:\\a.bvh"),
]


@pytest.mark.parametrize("url", URLS)
def test_media_with_any_address(takes: Path, url: str) -> None:
    path = spoilt(takes, "ExternalReference", target_url=url)
    assert code(path) == "BAT042"
    # What leads nowhere is looked for by the clip's name.
    found = MatchedFile(takes / "takes/take000.bvh", takes)
    path.write_text(path.read_text("utf-8").replace('"a"', '"take000"'), "utf-8")
    cuts = read_cuts(path, [found], is_excluded=lambda _: False)
    assert [cut.media for cut in cuts.shots] == [found]


def test_media_of_this_machine_by_its_address(takes: Path) -> None:
    place = (takes / "takes/take000.bvh").as_posix()
    for host in ("", "localhost"):
        path = spoilt(takes, "ExternalReference", target_url=f"file://{host}{place}")
        assert len(read_cuts(path).shots) == 1


def shots(cuts: CutList) -> list[str]:
    return [cut.shot_values["shot"] for cut in cuts.shots]


def test_names_that_are_long_or_many(takes: Path) -> None:
    count = 150
    names = shots(read_cuts(whole(takes, *["a" * 5000] * count)))
    assert len({name.casefold() for name in names}) == count
    assert max(map(len, names)) < 130
    assert shots(read_cuts(whole(takes, "a", "A_2", "a", "a"))) == [
        *("a", "A_2", "a_3", "a_4")
    ]
    with pytest.raises(AnimtoolError) as error:
        read_cut(whole(takes, *["b"] * count), "none", CutOptions())
    assert len(str(error.value)) < 2000


def test_faults_of_a_thousand_clips_are_not_all_told(takes: Path) -> None:
    clips = [clip(f"s{i}", "none.bvh", (1, 2)) for i in range(1000)]
    with pytest.raises(AnimtoolError) as error:
        read_cuts(timeline(takes / "a.otio", *clips))
    assert len(error.value.faults) == 101
    assert error.value.faults[-1].code == "DOC011"
