"""What pages cost in a browser that draws in software: time to open, time a picture.

Time a picture is CPU time of the browser's processes, as other work on a machine does
not change it; see README.md beside this file.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from measuring import HERE

sys.path.insert(0, str(HERE.parent))
from support.browser import CHROMIUM, chromium

PICTURES = 12
# Draws pictures one after another, each to its end, as edges are while a page plays.
DRAW = """async (count) => {
  const { app } = animtool, { gl, timeline, view, streams, scene } = app;
  const pixel = new Uint8Array(4);
  const before = performance.now();
  for (let i = 0; i < count; i++) {
    const sample = Math.floor(i * timeline.count / count);
    await streams.load(sample);
    scene.update(sample);
    scene.prepare(app.show, app.colors);
    view.update(null, streams, sample);
    scene.draw(view, app.show, app.colors, null, false);
    gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, pixel);
    app.curves.move();
    await new Promise((next) => setTimeout(next, 0));
  }
  return (performance.now() - before) / count;
}"""


@dataclass(frozen=True)
class Pictures:
    """What a page took."""

    opened: float  # until its first picture is drawn, of the wall clock [s]
    cpu: float  # a picture, in all processes of the browser [ms]
    wall: float  # likewise, of the wall clock [ms]
    heap: float  # of JavaScript, when all frames were seen [MB]


@contextmanager
def browsers() -> Iterator[Any]:
    """Yield a browser, or None where none is installed."""
    with ExitStack() as held:
        yield held.enter_context(chromium()) if CHROMIUM else None


def pictures(browser: Any, page: Path, count: int = PICTURES) -> Pictures:
    """Open a page and draw it; count: pictures, over all of its time."""
    begin = time.perf_counter()
    with browser.open(page) as opened:
        ready = time.perf_counter() - begin
        opened.run(DRAW, 2)
        before = _cpu()
        wall = opened.run(DRAW, count)
        cpu = (_cpu() - before) / count
        heap = opened.run("performance.memory?.usedJSHeapSize ?? 0") / 1e6
    return Pictures(ready, 1000 * cpu, wall, heap)


def _cpu() -> float:
    """Return the CPU time of the processes below this one [s]."""
    parents: dict[int, tuple[int, float]] = {}
    for folder in Path("/proc").iterdir():
        if not folder.name.isdigit():
            continue
        try:
            fields = (folder / "stat").read_text().rpartition(")")[2].split()
        except OSError:
            continue
        ticks = int(fields[11]) + int(fields[12])
        parents[int(folder.name)] = (int(fields[1]), ticks / os.sysconf("SC_CLK_TCK"))
    own = os.getpid()

    def below(process: int) -> bool:
        while process in parents and process != own:
            process = parents[process][0]
        return process == own

    return sum(ticks for p, (_, ticks) in parents.items() if p != own and below(p))
