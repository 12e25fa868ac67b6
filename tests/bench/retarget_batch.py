"""How much faster a batch brings a hundred takes onto a rig on two cores than on one.

Whole processes, started fresh. The takes are those of samples/retarget, as often as it
needs; every item reads its take and the rig, retargets, writes USD and its scores.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
from pathlib import Path

from clock import Taken
from figures import Bound, Clock, Row, time_rows
from measuring import ROOT, begin, in_turn, on_one_thread, parser, run

SAMPLE = ROOT / "samples/retarget"
FASTER = Bound(at_least=True, bound=1.8)


def prepared(folder: Path, count: int) -> Path:
    """Return a batch file of so many takes."""
    shutil.copytree(ROOT / "rigs/biped", folder / "biped")
    (folder / "takes").mkdir()
    sources = sorted((SAMPLE / "takes").iterdir())
    for i in range(count):
        source = sources[i % len(sources)]
        shutil.copyfile(source, folder / f"takes/{source.stem}_{i:03}.bvh")
    (folder / "onto.scene.yaml").write_text(
        "scene: animtool/1\nsource: {file: ${input}}\n"
        "passes:\n- retarget: {rig: biped/biped.rig.yaml}\n"
    )
    path = folder / "onto.batch.yaml"
    path.write_text(
        "batch: animtool/1\ninputs: [takes]\nscene: onto.scene.yaml\n"
        "output: 'out/{stem}.usdc'\n"
    )
    return path


def measure(path: Path, count: int, runs: int) -> list[Row]:
    """Time the batch on one core and on two, in turn."""
    spent: list[float] = []

    def route(jobs: int) -> Taken:
        shutil.rmtree(path.parent / "out", ignore_errors=True)
        command = [sys.executable, "-m", "animtool", "batch", str(path)]
        done = run([*command, "-q", "--format", "json", "-j", str(jobs)])
        items = done.report["items"]
        assert done.report["done"] == count
        assert all(item["scores"] for item in items)
        if jobs == 1:
            spent.append(sum(item["seconds"] for item in items) / count * 1000)
        return done.taken

    one, two = "-j 1", "-j 2"
    taken = in_turn({one: lambda: route(1), two: lambda: route(2)}, runs)
    section = f"{count} takes onto the biped"
    faster = [a.wall / b.wall for a, b in zip(taken[one], taken[two], strict=True)]
    cores = [each.cpu / each.wall for each in taken[two]]
    return [
        *time_rows(section, one, taken[one]),
        Row(section, one, "an item [ms]", spent[1:], clock=Clock.WALL),
        *time_rows(section, two, taken[two]),
        Row(section, two, "times as fast", faster, FASTER, Clock.WALL),
        Row(section, two, "cores in use", cores),
    ]


def main() -> None:
    """Measure, print the tables, write the CSV."""
    made = parser(__doc__, "retarget_batch.csv", runs=3)
    made.add_argument("--takes", type=int, default=100)
    options = made.parse_args()
    on_one_thread()
    session = begin(options, (sys.executable, ["animtool", "numpy", "usd-core"]))
    with tempfile.TemporaryDirectory() as folder:
        path = prepared(Path(folder), options.takes)
        rows = measure(path, options.takes, options.runs)
    session.finish(options.csv, rows)


if __name__ == "__main__":
    main()
