from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from support.cli import animtool
from support.drawing import need_drawing
from support.small_takes import small

from animtool import PictureOptions, PreviewOptions, show, write_pictures
from animtool.core.errors import AnimtoolError
from animtool.core.shot import FrameList, FrameRange
from animtool.preview.pictures import device
from animtool.preview.pictures.build import SHEET_GAP

SMALL = {"size": "96x72"}


@pytest.fixture(autouse=True)
def drawn() -> None:
    need_drawing()


def pixels(path: Path) -> np.ndarray:
    from PIL import Image

    with Image.open(path) as image:
        return np.asarray(image.convert("RGB"), int)


def shown(image: np.ndarray) -> np.ndarray:
    """Return which pixels are no background, beneath what fades."""
    return np.abs(image - image[0, 0]).max(axis=-1) > 24


@pytest.mark.slow
def test_a_still_shows_its_frame_and_is_the_same_each_time(
    walk: Path, tmp_path: Path
) -> None:
    paths = [tmp_path / name for name in ("a.png", "b.png", "c.png")]
    for path, frame in zip(paths, (1, 1, 40), strict=True):
        frames = PreviewOptions(frame_range=FrameRange(frame, frame))
        report = write_pictures([walk], path, frames, PictureOptions(**SMALL))
        assert (report.frames, report.rate) == ((frame,), 0)
        assert report.size == path.stat().st_size
    one, same, other = (path.read_bytes() for path in paths)
    assert one == same != other
    image = pixels(paths[0])
    assert image.shape == (72, 96, 3)
    assert 0.01 < shown(image).mean() < 0.6
    assert b"tEXt" not in one


def test_listed_frames_stand_side_by_side(walk: Path, tmp_path: Path) -> None:
    frames = PreviewOptions(frame_range=FrameList.of_frames([1, 20, 40]))
    path = tmp_path / "sheet.png"
    report = write_pictures([walk], path, frames, PictureOptions(**SMALL))
    assert report.frames == (1, 20, 40)
    assert report.pixels == (3 * 96 + 2 * SHEET_GAP, 72)
    image = pixels(path)
    cells = [image[:, k * (96 + SHEET_GAP) :][:, :96] for k in range(3)]
    assert all(0.01 < shown(cell).mean() < 0.6 for cell in cells)
    assert not np.array_equal(cells[0], cells[1])


@pytest.mark.parametrize(
    ("asked", "columns", "rows"),
    [({"sheet": "3x2"}, 3, 2), ({"camera": ("front", "side"), "sheet": "2x2"}, 2, 2)],
)
def test_a_sheet_is_spread_over_the_motion(
    walk: Path, tmp_path: Path, asked: dict[str, object], columns: int, rows: int
) -> None:
    path = tmp_path / "sheet.png"
    options = PictureOptions(**SMALL, **asked, numbers=False)
    report = write_pictures([walk], path, None, options)
    assert report.pixels == (columns * 100 - SHEET_GAP, rows * 76 - SHEET_GAP)
    assert (report.frames[0], report.frames[-1]) == (1, 64)


def test_a_caption_is_above_what_is_shown(walk: Path, tmp_path: Path) -> None:
    images = []
    for i, text in enumerate([(), ("a caption " * 4,)]):
        path = tmp_path / f"{i}.png"
        options = PictureOptions(
            size="240x180", caption=text, show=("bones",), camera=("front",)
        )
        write_pictures([walk], path, None, options)
        images.append(pixels(path))
    plain, captioned = map(shown, images)
    tops = [np.flatnonzero(image.any(axis=1))[0] for image in (plain, captioned)]
    assert tops[1] < tops[0]
    # What is shown is smaller, and whole.
    assert plain.any(axis=1)[:-4].any()
    assert not captioned[:, [0, -1]].any()
    assert not captioned[-1].any()


def test_the_whole_motion_is_in_the_picture(walk: Path, tmp_path: Path) -> None:
    path = tmp_path / "sheet.png"
    options = PictureOptions(sheet="8x8", size="64x48", show=("bones",), numbers=False)
    write_pictures([walk], path, None, options)
    image = shown(pixels(path))
    for row in range(8):
        for column in range(8):
            cell = image[row * 52 :][:48, column * 68 :][:, :64]
            assert cell.any()
            assert not cell[[0, -1]].any()
            assert not cell[:, [0, -1]].any()


@pytest.mark.slow(1.1)
@pytest.mark.parametrize("suffix", [".gif", ".webp", ".mp4", ".webm"])
def test_a_film_plays_at_the_rate_of_the_motion(
    walk: Path, tmp_path: Path, suffix: str
) -> None:
    import av

    paths = [tmp_path / f"{name}{suffix}" for name in "ab"]
    frames = PreviewOptions(frame_range=FrameRange(1, 12))
    for path in paths:
        report = write_pictures([walk], path, frames, PictureOptions(**SMALL))
    assert paths[0].read_bytes() == paths[1].read_bytes()
    assert (report.frames, report.rate) == (tuple(range(1, 13)), Fraction(30))
    if suffix == ".webp":
        from PIL import Image

        with Image.open(paths[0]) as image:
            assert (image.n_frames, image.size) == (12, (96, 72))
        return
    with av.open(str(paths[0])) as container:
        (stream,) = container.streams
        decoded = [frame.to_ndarray(format="rgb24") for frame in container.decode()]
    assert stream.codec_context.name.startswith({".gif": "gif"}.get(suffix, "vp9"))
    assert len(decoded) == 12
    assert decoded[0].shape == (72, 96, 3)
    still = tmp_path / "still.png"
    options = PictureOptions(**SMALL, numbers=True)
    one = PreviewOptions(frame_range=FrameRange(1, 1))
    write_pictures([walk], still, one, options)
    # The first frame; the camera of the film has all the others in its picture.
    assert np.abs(decoded[0].astype(int).mean() - pixels(still).mean()) < 6


@pytest.mark.slow
def test_a_turntable_goes_round_and_comes_back(tmp_path: Path) -> None:
    from PIL import Image

    path = tmp_path / "round.gif"
    shown_take = show(small())
    shown_take.save(path, pictures=PictureOptions(**SMALL, turntable=True))
    with Image.open(path) as image:
        assert image.n_frames == len(small())
    with pytest.raises(AnimtoolError) as error:
        shown_take.save(tmp_path / "a.png", pictures=PictureOptions(turntable=True))
    assert error.value.code == "PRV006"


@pytest.mark.parametrize(
    ("name", "asked", "frames", "code"),
    [
        ("a.ply", {}, None, "PRV002"),
        ("a.%04d.png", {}, None, "PRV002"),
        ("a.####.png", {}, None, "PRV002"),
        ("a.html", {}, None, "PRV002"),
        ("a.png", {"size": "12"}, None, "PRV006"),
        ("a.png", {"size": "9x9"}, None, "PRV006"),
        ("a.png", {"sheet": "0x3"}, None, "PRV006"),
        ("a.png", {"sheet": "1x1"}, (1, 2), "PRV006"),
        ("a.png", {"camera": ("frnt",)}, None, "PRV006"),
        ("a.png", {"light": "up"}, None, "PRV006"),
        ("a.png", {"show": ("bonez",)}, None, "PRV006"),
        ("a.png", {"caption": ("a", "b")}, None, "PRV006"),
        ("a.png", {"caption": ("word " * 999,)}, None, "PRV006"),
        ("a.mp4", {"sheet": "2x2"}, None, "PRV006"),
        ("a.gif", {}, (1, 2), "PRV006"),
        ("a.gif", {"camera": ("front", "side")}, None, "PRV006"),
        ("a.png", {}, (1, 900), "CLI005"),
    ],
)
def test_what_makes_no_sense_is_refused(
    walk: Path,
    tmp_path: Path,
    name: str,
    asked: dict[str, object],
    frames: tuple[int, ...] | None,
    code: str,
) -> None:
    options = PreviewOptions(frame_range=frames and FrameList.of_frames(frames))
    pictures = PictureOptions(**{**SMALL, **asked})
    with pytest.raises(AnimtoolError) as error:
        write_pictures([walk], tmp_path / name, options, pictures)
    assert error.value.code == code
    assert list(tmp_path.iterdir()) == []


def test_a_machine_without_opengl_is_told_what_to_install(
    walk: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import moderngl

    def fail(**_: object) -> None:
        raise OSError("libEGL.so.1: cannot open shared object file")

    monkeypatch.setattr(moderngl, "create_context", fail)
    done = animtool("preview", walk, "-o", tmp_path / "a.png")
    assert done.code == 2
    assert "PRV005" in done.stderr
    assert "libEGL.so.1" in done.stderr
    assert "libgl1-mesa-dri" in done.stderr
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["moderngl", "av", "PIL.Image"])
def test_a_missing_package_is_named_with_its_extra(
    walk: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    found = device.import_module

    def missing(module: str) -> object:
        if module == name:
            raise ModuleNotFoundError(name=module)
        return found(module)

    monkeypatch.setattr(device, "import_module", missing)
    done = animtool("preview", walk, "-o", tmp_path / "a.gif")
    assert done.code == 2
    assert "IO005" in done.stderr
    assert "animtool[pictures]" in done.stderr


def test_the_command_says_what_it_wrote(walk: Path, tmp_path: Path) -> None:
    import json

    path = tmp_path / "walk.png"
    asked = ("--range", "1,20", "--size", "64x48", "--format", "json")
    done = animtool("preview", walk, "-o", path, *asked)
    report = json.loads(done.stdout)
    assert (done.code, report["bytes"]) == (0, path.stat().st_size)
    assert (report["frames"], report["first"], report["last"]) == (2, 1, 20)
    assert (report["width"], report["height"]) == (2 * 64 + SHEET_GAP, 48)
    assert animtool("preview", walk, "-o", path).code == 2
    assert animtool("preview", walk, "--size", "64x48", "--no-open").code == 2
    listed = animtool("preview", walk, "-o", tmp_path / "a.html", "--range", "1,2")
    assert "PRV006" in listed.stderr
