"""The runner itself: which bugs it finds, draws and counts."""

from __future__ import annotations

from pathlib import Path

import pytest

from mutation import python, syntax
from mutation.engine import own, stages
from mutation.mutants import (
    Edit,
    Mutant,
    Result,
    Results,
    draw,
    mutants_of,
    read_equivalents,
    tallies,
)


def after(source: str) -> set[str]:
    """Return the lines that bugs make of a source."""
    found = mutants_of("maths", "a.py", source, syntax.edits(source))
    return {mutant.after for line in found for mutant in line}


@pytest.mark.parametrize(
    ("line", "bugs"),
    [
        ("a < b", {"a <= b"}),
        ("a is not b", {"a is b"}),
        ("a not in b", {"a in b"}),
        ("a + b", {"a - b"}),
        ("a * SCALE", {"a / SCALE", "a"}),
        ("a and b", {"a or b"}),
        ("not a", {"a"}),
        ("x = -a", {"x = a"}),
        ("a[0]", {"a[1]", "a[-1]"}),
        ("a[b:]", {"a[(b) + 1:]"}),
        ("a[:, -1]", {"a[:, 0]"}),
        ("x = a.T", {"x = a"}),
        ("x = a @ b", {"x = b @ a"}),
        ("x = min(a, b)", {"x = max(a, b)"}),
        ("x = sorted(a)", {"x = list(a)"}),
        ("x = f(a, b)", {"x = f(b, a)"}),
        ("x = f(a, axis=1)", {"x = f(a, axis=0)"}),
        ("x = f(a, b=c)", {"x = f(a)"}),
        ("x = f(b=c, d=e)", {"x = f(d=e)", "x = f(b=c)"}),
        ("f()", {"pass"}),
        ("a += b", {"a -= b"}),
        ("x = True", {"x = False"}),
        ("x = 1e-6", {"x = 1e-05"}),
        ("x = 200", {"x = 2000", "x = 20"}),
        ("x = a if b else c", {"x = a if True else c", "x = a if False else c"}),
        ("for x in a: break", {"for x in a: continue"}),
        ("def f(): return a, b", {"def f(): return b, a"}),
        ("x: int = 2", {"x: int = 1", "x: int = 3"}),
        ('x = key("a", 2, default=True)', {'x = key("a", 2, default=False)'}),
        ("élan = a < b", {"élan = a <= b"}),
    ],
)
def test_bugs_of_a_line(line: str, bugs: set[str]) -> None:
    assert after(line) == bugs


@pytest.mark.parametrize(
    "source",
    [
        '"""Text 1 < 2."""',
        "from a import b",
        "def f(a: list[0], b: X | Y) -> tuple[1]: ...",
        "raise Error(1, a < b)",
        "assert a < b",
        "logger.warning(a, b)",
        'x = f"{a + 1}"',
        'f = g(help="a", description=a < b)',
        "__all__ = [1]",
        "Vector = Literal[0, 1]",
        'x = "a" + b',
        "x = isinstance(a, Path | b.Frame)",
    ],
)
def test_what_is_left_alone(source: str) -> None:
    assert after(source) == set()


def test_only_what_compiles_is_valid() -> None:
    assert python.valid("x = 1")
    assert not python.valid("continue")


SOURCE = "\n".join(f"x{i} = a{i} < b{i}" for i in range(40))


def sample(source: str, seed: int = 0) -> list[Mutant]:
    lines = mutants_of("maths", "a.py", source, syntax.edits(source))
    return draw(lines, 10, seed, lambda _: True)


def test_a_change_elsewhere_keeps_the_sample() -> None:
    keys = {mutant.key for mutant in sample(SOURCE)}
    assert len(keys) == 10
    moved = sample("import one\n\n" + SOURCE)
    assert {mutant.key for mutant in moved} == keys
    assert {mutant.key for mutant in sample(SOURCE, seed=1)} != keys


def test_equal_lines_are_told_apart() -> None:
    source = "x = a < b\ny = 0\nx = a < b"
    lines = mutants_of("maths", "a.py", source, syntax.edits(source))
    same = [mutant for line in lines for mutant in line if mutant.before == "x = a < b"]
    assert [mutant.occurrence for mutant in same] == [0, 1]


def mutant(path: str = "animtool/maths/so3.py", name: str = "a") -> Mutant:
    return Mutant("maths", path, Edit(1, 0, 1, "b", "order"), name, f"{name}?", 0)


def test_near_tests_come_first_and_the_budget_bounds_the_rest() -> None:
    seconds = {
        "tests/maths/test_so3.py::slow": 5.0,
        "tests/maths/test_so3.py::quick": 1.0,
        "animtool/maths/so3.py::doctest": 0.5,
        "tests/maths/test_rigid.py::one": 1.0,
        "tests/cli/test_bake.py::one": 1.0,
        "tests/cli/test_bake.py::two": 2.0,
    }
    found, left = stages(mutant(), seconds, seconds, budget=9.0)
    assert found == [
        [
            "animtool/maths/so3.py::doctest",
            "tests/maths/test_so3.py::quick",
            "tests/maths/test_so3.py::slow",
        ],
        ["tests/maths/test_rigid.py::one"],
        ["tests/cli/test_bake.py::one"],
    ]
    assert left == 1


def test_own_tests_are_those_of_the_package_and_of_the_module() -> None:
    edit = Edit(1, 0, 1, "x", "sign")
    names = {
        "tests/systems/rigid/test_a.py::b",
        "tests/systems/springs/test_a.py::b",
        "tests/kernels/test_a.py::b",
        "tests/cli/test_a.py::b",
        "animtool/systems/rigid/a.py::animtool.systems.rigid.a",
    }
    one = Mutant("systems/rigid", "animtool/systems/rigid/a.py", edit, "a", "x", 0)
    assert own(one, names) == {name for name in names if "systems/rigid" in name}
    one = Mutant("kernels", "animtool/kernels/springs/a.cpp", edit, "a", "x", 0)
    assert own(one, names) == {
        "tests/systems/springs/test_a.py::b",
        "tests/kernels/test_a.py::b",
    }


def test_each_kind_of_system_is_a_package(tmp_path: Path) -> None:
    for name in ("__main__", "ik/a", "ik/b/c", "systems/run", "systems/rigid/a"):
        path = tmp_path / f"animtool/{name}.py"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
    assert {name: len(files) for name, files in python.packages(tmp_path).items()} == {
        "animtool": 1,
        "ik": 2,
        "systems": 1,
        "systems/rigid": 1,
    }


def test_results_outlast_the_run_and_the_last_one_counts(tmp_path: Path) -> None:
    path = tmp_path / "results.jsonl"
    results = Results(path)
    results.add(mutant(), Result("survived", tests=3, ran=3))
    results.add(mutant(), Result("killed", "tests/test_a.py::b", 3, 1))
    assert Results(path).get(mutant()) == Result("killed", "tests/test_a.py::b", 3, 1)
    assert Results(path).get(mutant(name="c")) is None


def test_the_table_counts_equivalents_apart(tmp_path: Path) -> None:
    results = Results(tmp_path / "results.jsonl")
    outcomes = ["killed", "timed out", "survived", "uncovered", "survived", "invalid"]
    drawn = [mutant(name=str(i)) for i in range(7)]
    for one, outcome in zip(drawn, outcomes, strict=False):
        results.add(one, Result(outcome))
    found = tallies(drawn, results, {drawn[4].key: "no"})
    row = found["all"]
    assert (row.mutants, row.killed, row.survived, row.equivalent) == (5, 2, 2, 1)
    assert (row.rate, row.rate_apart) == (0.4, 0.5)
    assert found["maths"] == row


def test_equivalents_name_a_line_and_a_reason() -> None:
    file = Path(__file__).with_name("equivalent.jsonl")
    for (path, before, after, occurrence), reason in read_equivalents(file).items():
        assert Path(path).parts[0] == "animtool"
        assert before != after
        assert occurrence >= 0
        assert reason
