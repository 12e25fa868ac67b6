"""What pages cost: their size, the time that they take to make, and the memory.

Each page is made by a process of its own, as the command makes it; see README.md beside
this file.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from figures import Bound, Clock, Row
from measuring import HERE, ROOT, Run, begin, on_one_thread, parser, run
from preview_pictures import browsers, pictures

OWN = "animtool preview"
JOINTS, RATE = 60, 60
# Frames of takes of 60 joints, with bounds: bytes of the page, and CPU time beyond that
# of a page of one frame [s].
TAKES: dict[int, tuple[float, float | None]] = {600: (400e3, 0.5), 10_000: (12e6, None)}
# CPU time of a picture: 60 a second of a skeleton and 15 of skins, on two processors
# [ms].
SKELETON, SKINS = 2 * 1000 / 60, 2 * 1000 / 15
SAMPLES = (
    "walk/walk.bvh",
    "stride/stride.clip.yaml",
    "press/press.clip.yaml",
    "speech/speech.clip.yaml",
    "capture/capture.scene.yaml",
    "carry/carry.scene.yaml",
    "shot/shot.scene.yaml",
    "rope/rope.scene.yaml",
    "rope/lantern.scene.yaml",
    "cape/cape.scene.yaml",
    "flag/flag.scene.yaml",
    "drape/drape.scene.yaml",
    "sheets/sheets.scene.yaml",
    "fall/fall.scene.yaml",
    "dominoes/dominoes.scene.yaml",
    "wrecking_ball/wrecking_ball.scene.yaml",
    "embers/embers.scene.yaml",
    "dam/dam.scene.yaml",
    "galaxies/galaxies.scene.yaml",
    "orbits/orbits.scene.yaml",
    "argon/argon.scene.yaml",
    "murmuration/murmuration.scene.yaml",
    "crowd/square.scene.yaml",
)


def write_take(path: Path, frames: int) -> None:
    """Write a BVH of a size, in a process of its own: this one is to stay small."""
    words = [sys.executable, "-P", str(HERE / "preview_take.py"), str(path)]
    run([*words, str(frames), str(JOINTS), str(RATE)], report=False)


def rows_of(
    section: str,
    runs: Sequence[Run],
    base: Sequence[Run] = (),
    most: float | None = None,
    beyond: float | None = None,
) -> list[Row]:
    """Return what pages of one kind cost; base: runs of a page of one frame."""

    def bound(value: float | None) -> Bound | None:
        return None if value is None else Bound(at_least=False, bound=value)

    report, taken = runs[0].report, [one.taken for one in runs]
    rows = [
        Row(section, OWN, "page [kB]", [report["bytes"] / 1e3],
            bound(None if most is None else most / 1e3)),
        Row(section, OWN, "frames", [report["frames"]]),
        Row(section, OWN, "largest error [mm]", [report["position_error_mm"]]),
        Row(section, OWN, "CPU [s]", [one.cpu for one in taken], clock=Clock.CPU),
        Row(section, OWN, "wall [s]", [one.wall for one in taken], clock=Clock.WALL),
        Row(section, OWN, "memory [MB]", [one.peak_bytes / 1e6 for one in runs]),
    ]  # fmt: skip
    if base:
        left = [a.cpu - b.taken.cpu for a, b in zip(taken, base, strict=True)]
        name = "CPU beyond a page of one frame [s]"
        rows.append(Row(section, OWN, name, left, bound(beyond), Clock.CPU))
    return rows


def picture_rows(section: str, browser: Any, page: Path, most: float) -> list[Row]:
    """Return what a page costs in a browser; most: CPU time a picture [ms]."""
    if browser is None:
        return []
    shown = pictures(browser, page)
    bound = Bound(at_least=False, bound=most)
    return [
        Row(section, OWN, "first picture [s]", [shown.opened], clock=Clock.WALL),
        Row(section, OWN, "CPU a picture [ms]", [shown.cpu], bound, Clock.CPU),
        Row(section, OWN, "wall a picture [ms]", [shown.wall], clock=Clock.WALL),
        Row(section, OWN, "heap of JavaScript [MB]", [shown.heap]),
    ]


def previewed(path: Path, output: Path) -> Run:
    """Make a page in a process of its own."""
    words = [sys.executable, "-P", "-m", "animtool", "preview", str(path)]
    made = run([*words, "-o", str(output), "--overwrite", "--format", "json"])
    print(f"  {path.name}: {made.taken.cpu:.3g} s", file=sys.stderr)
    return made


def main() -> None:
    """Measure, print and write the table."""
    options = parser(__doc__, "preview.csv", 3).parse_args()
    on_one_thread()
    session = begin(options, (sys.executable, ["animtool", "numpy", "usd-core"]))
    rows: list[Row] = []
    with tempfile.TemporaryDirectory() as name, browsers() as browser:
        folder = Path(name)
        page = folder / "page.html"
        files = [folder / f"{frames}.bvh" for frames in (1, *TAKES)]
        for path in files:
            write_take(path, int(path.stem))
        runs: dict[Path, list[Run]] = {path: [] for path in files}
        for _ in range(options.runs):
            for path in files:
                runs[path].append(previewed(path, page))
        for path, (most, beyond) in zip(files[1:], TAKES.values(), strict=True):
            section = f"{JOINTS} joints, {path.stem} frames"
            rows += rows_of(section, runs[path], runs[files[0]], most, beyond)
            previewed(path, page)
            rows += picture_rows(section, browser, page, SKELETON)
        for part in ("samples", "rigs"):
            shutil.copytree(ROOT / part, folder / part)
        (folder / "animtool.toml").touch()
        for sample in SAMPLES:
            made = [previewed(folder / "samples" / sample, page)]
            rows += rows_of(sample, made)
            rows += picture_rows(sample, browser, page, SKINS)
    session.finish(options.csv, rows)


if __name__ == "__main__":
    main()
