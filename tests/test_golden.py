"""The script that hashes every result: what it replaces, lists and compares."""

from __future__ import annotations

from pathlib import Path

import pytest
from golden import compare, main, read_list, written
from support.normalise import normalise

MEASURED = [
    ("  3.7 MB written in 17.5 s", "  3.7 MB written in 950 ms"),
    (
        "2 kB written in 20 ms, 1.84 MB/s of source",
        "2 kB written in 1 s, 98.6 kB/s of source",
    ),
    (
        "  body: 2 MB, 804 µs per frame, 0.084 µm",
        "  body: 2 MB, 1.1 s per frame, 0.084 µm",
    ),
    (
        "face: 9 shapes move, 64 frames per second",
        "face: 9 shapes move, 60 frames per second",
    ),
    ("[3/12] done wave3.usdc (new) 0.03 s", "[3/12] done wave3.usdc (new) 1.10 s"),
    ("12 items: 12 done in 0.76 s", "12 items: 12 done in 11.02 s"),
    ("  slowest: a.usdc 0.10 s, b.usdc 0.08 s", "  slowest: b.usdc 0.31 s"),
    (
        "  rk4 is as accurate in 60% of the time",
        "  heun is as accurate in 9% of the time",
    ),
    ('  "seconds": 0.020284,', '  "seconds": 1e-06,'),
    (
        '{"seconds": {"read": 0.1, "total": 0.2}}',
        '{"seconds": {"read": 7, "total": 9}}',
    ),
    ('  "microseconds_per_frame": 627.8604,', '  "microseconds_per_frame": 99.5,'),
    ('  "simulated_per_second": 70.6', '  "simulated_per_second": null'),
]
TABLES = [
    """\
stage     seconds  peak MB  error mm
walk.bvh    0.051     28.6
o.usdc      0.077            0.00011
""",
    """\
   tolerance    µs/frame    worst mm
       1e-07         155   0.0000783
        auto         268    0.000735
    two_bone  cannot: more than one
""",
    """\
      method   setting    seconds  sim s/s  largest mm
  *+  rk4      step 0.08  0.00257     81.1    0.000112
  >   heun     step 0.02  0.00429     48.6        0.02
  *   lsoda    step 0.02     0.01     48.6        0.02
""",
]
# The same of another run: other numbers, the marks of the fastest elsewhere.
AGAIN = [
    """\
stage     seconds  peak MB  error mm
walk.bvh    0.009    128.6
o.usdc      1.077            0.00011
""",
    """\
   tolerance    µs/frame    worst mm
       1e-07        99.5   0.0000783
        auto       11500    0.000735
    two_bone  cannot: more than one
""",
    """\
     method   setting     seconds  sim s/s  largest mm
     rk4      step 0.08   0.00313      8.1    0.000112
  >  heun     step 0.02       0.1     48.6        0.02
  *  lsoda    step 0.02  0.000101    148.6        0.02
""",
]
KEPT = [
    "rate     6 fps        6  474  toe_l at 0.96 s",
    "flag.scene.yaml:7:5: note: SIM130 steps of 0.000521 s and more",
    "  72 samples, frames 1 to 72 at 24 fps",
    "  largest error of float32: 0.12 µm (joint 'LeftUpLeg', frame 63)",
    '  "duration": 2.1,',
    "  damped  0.000735",
    "    indented,  in  columns",
]


@pytest.mark.parametrize(
    ("one", "other"), [*MEASURED, *zip(TABLES, AGAIN, strict=True)]
)
def test_what_is_measured_is_replaced(one: str, other: str) -> None:
    assert normalise(one) == normalise(other)


@pytest.mark.parametrize("line", KEPT)
def test_nothing_else_is_replaced(line: str) -> None:
    assert normalise(f"{line}\n") == f"{line}\n"


@pytest.mark.parametrize("table", TABLES)
def test_other_columns_and_what_follows_a_table_are_kept(table: str) -> None:
    error = "0.0000783" if "0.0000783" in table else "0.00011"
    changed = table.replace(error, error.replace("1", "2").replace("7", "8"))
    assert normalise(changed) != normalise(table)
    assert normalise(f"{table}\n  at   0.051").endswith("\n\n  at   0.051")


def test_items_of_a_batch_have_no_order() -> None:
    lines = [f"[{i}/2] done {name} (new) 0.{i} s" for i, name in enumerate("ab", 1)]
    turned = [lines[1].replace("[2", "[1"), lines[0].replace("[1", "[2")]
    first, second = ("\n".join(["one", *each, "end"]) for each in (lines, turned))
    assert normalise(first) == normalise(second)
    assert normalise(first.replace("done b", "failed b")) != normalise(second)


def test_lists_are_compared_by_name(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    old, new = tmp_path / "old.txt", tmp_path / "new.txt"
    lines = [f"{i:064x} 0 case {i}: bake a b > c" for i in range(4)]
    old.write_text("".join(f"{line}\n" for line in lines), "utf-8")
    new.write_text(old.read_text("utf-8"), "utf-8")
    assert main(["--compare", str(old), str(new)]) == 0
    changed = [
        lines[0].replace(" 0 ", " timeout "),
        lines[1].replace("1 0", "f 0"),
        lines[3],
        lines[3].replace("case 3", "case 4"),
    ]
    new.write_text("".join(f"{line}\n" for line in changed), "utf-8")
    assert main(["--compare", str(old), str(new)]) == 1
    assert capsys.readouterr().out.splitlines() == [
        "changed  case 0: bake a b > c (0, now timeout)",
        "changed  case 1: bake a b > c",
        "gone     case 2: bake a b > c",
        "added    case 4: bake a b > c",
    ]
    assert compare(read_list(old), read_list(old)) == []


def test_a_line_of_another_kind_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "old.txt"
    path.write_text("not a hash 0 case\n", "utf-8")
    with pytest.raises(SystemExit, match=r"old\.txt:1: not a line"):
        read_list(path)


def test_files_written_changed_and_removed_are_listed(tmp_path: Path) -> None:
    for name in ("kept", "changed", "removed"):
        (tmp_path / name).write_text(name, "utf-8")
    with written(tmp_path, "case", "animtool ik --table --plot a.png") as results:
        (tmp_path / "changed").write_text("longer than it was", "utf-8")
        (tmp_path / "removed").unlink()
        for name in ("a.png", "b.png"):
            (tmp_path / name).write_text(name, "utf-8")
        (tmp_path / ".animtool").mkdir()
        (tmp_path / ".animtool/batch.lock").touch()
    found = {result.name: result.digest for result in results}
    assert {name for name in found if len(found[name]) == 64} == {
        "case > b.png",
        "case > changed",
    }
    assert found["case > removed"] == "removed"
    assert found["case > a.png"] == found["case > .animtool/batch.lock"] == "measured"
    assert len(found) == 5
