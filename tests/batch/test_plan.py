"""Why an item is made again, or not."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from support.batch import take_files

from animtool.batch.discover import find_batch
from animtool.batch.plan import check_output_files
from animtool.batch.report import BatchReport
from animtool.batch.run import RunOptions, run_batch
from animtool.batch.spec import BatchSpec, package_versions
from animtool.core.errors import OptionError
from animtool.scene.bake.options import BakeOptions

SERIAL = RunOptions(executor="serial")
DRY = RunOptions(dry_run=True)
SCENE = (
    "scene: animtool/1\nvariables: {first: 1}\nsource:\n  file: ${input}\n"
    "passes:\n- trim:\n    first: ${first}\n"
)


@pytest.fixture
def takes(tmp_path: Path) -> Path:
    for path in take_files(tmp_path / "takes", 3):
        # Long before anything is made of it.
        os.utime(path, ns=(10**18, 10**18))
    return tmp_path


def spec(folder: Path, **given: object) -> BatchSpec:
    return BatchSpec(
        ("takes/*.bvh",),
        folder,
        output="out/{stem}.usdc",
        **given,  # type: ignore[arg-type]
    )


def reasons(report: BatchReport) -> list[str]:
    return [str(entry.reason) for entry in report.items]


def test_the_first_time_and_the_second(takes: Path) -> None:
    first = run_batch(spec(takes), SERIAL)
    assert reasons(first) == ["new"] * 3
    assert [entry.status for entry in first.items] == ["done"] * 3
    second = run_batch(spec(takes), SERIAL)
    assert reasons(second) == ["up to date"] * 3
    assert [entry.status for entry in second.items] == ["skipped"] * 3


def test_an_input_that_changed_and_then_failed_has_failed(takes: Path) -> None:
    run_batch(spec(takes), SERIAL)
    spoilt = takes / "takes/take001.bvh"
    spoilt.write_text("HIERARCHY\n")
    assert reasons(run_batch(spec(takes), DRY))[1] == "input changed"
    run_batch(spec(takes), SERIAL)
    planned = run_batch(spec(takes), DRY)
    assert reasons(planned) == ["up to date", "failed last time", "up to date"]
    assert planned.items[1].detail.startswith("BVH")


def _touch(folder: Path) -> None:
    os.utime(folder / "takes/take001.bvh", ns=(10**18 + 1, 10**18 + 1))


def _rewrite(folder: Path) -> None:
    path = folder / "takes/take001.bvh"
    path.write_text(path.read_text() + " ")


def _same_size_and_time(folder: Path) -> None:
    path = folder / "takes/take001.bvh"
    text, state = path.read_text(), path.stat()
    path.write_text(text.replace("Spine", "Spina"))
    os.utime(path, ns=(state.st_atime_ns, state.st_mtime_ns))


def _settings(folder: Path) -> None:
    (folder / "takes/animtool.toml").write_text("start = 5\n")


def _lose_output(folder: Path) -> None:
    (folder / "out/take001.usdc").unlink()


def _spoil_output(folder: Path) -> None:
    (folder / "out/take001.usdc").write_bytes(b"spoilt")


@pytest.mark.parametrize(
    ("change", "found", "detail"),
    [
        (_touch, ["up to date", "up to date", "up to date"], ""),
        (
            _rewrite,
            ["up to date", "input changed", "up to date"],
            "../takes/take001.bvh",
        ),
        (_settings, ["input changed"] * 3, "../takes/animtool.toml"),
        (
            _lose_output,
            ["up to date", "output changed", "up to date"],
            "take001.usdc",
        ),
        (
            _spoil_output,
            ["up to date", "output changed", "up to date"],
            "take001.usdc",
        ),
    ],
)
def test_files_that_changed(
    takes: Path, change: Callable[[Path], None], found: list[str], detail: str
) -> None:
    run_batch(spec(takes), SERIAL)
    change(takes)
    report = run_batch(spec(takes), DRY)
    assert reasons(report) == found
    assert report.items[1].detail == detail
    run_batch(spec(takes), SERIAL)
    assert reasons(run_batch(spec(takes), DRY)) == ["up to date"] * 3


def test_a_change_without_a_sign_is_found_by_verify(takes: Path) -> None:
    run_batch(spec(takes), SERIAL)
    _same_size_and_time(takes)
    assert reasons(run_batch(spec(takes), DRY)) == ["up to date"] * 3
    verified = run_batch(spec(takes), replace(DRY, verify=True))
    assert reasons(verified)[1] == "input changed"


def test_a_change_of_a_file_as_young_as_its_record_is_found(takes: Path) -> None:
    path = takes / "takes/take001.bvh"
    # As if the clock stood still: written, made of, and written again.
    late = 4 * 10**18
    os.utime(path, ns=(late, late))
    run_batch(spec(takes), SERIAL)
    assert reasons(run_batch(spec(takes), DRY)) == ["up to date"] * 3
    path.write_text(path.read_text().replace("Spine", "Spina"))
    os.utime(path, ns=(late, late))
    assert reasons(run_batch(spec(takes), DRY))[1] == "input changed"


def test_touched_files_are_read_once(
    takes: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run_batch(spec(takes), SERIAL)
    _touch(takes)
    read: list[Path] = []
    from animtool.batch import plan

    digest = plan.file_digest

    def counted(path: Path) -> str:
        read.append(path)
        return digest(path)

    monkeypatch.setattr(plan, "file_digest", counted)
    run_batch(spec(takes), SERIAL)
    assert [path.name for path in read] == ["take001.bvh"]
    run_batch(spec(takes), SERIAL)
    assert len(read) == 1


def test_options_and_variables(takes: Path) -> None:
    run_batch(spec(takes), SERIAL)
    other = spec(takes, options=BakeOptions(fps=24))
    assert reasons(run_batch(other, DRY)) == ["options changed"] * 3
    (takes / "t.scene.yaml").write_text(SCENE)
    scene = spec(takes, scene=takes / "t.scene.yaml")
    assert reasons(run_batch(scene, SERIAL)) == ["options changed"] * 3
    assert reasons(run_batch(scene, DRY)) == ["up to date"] * 3
    later = replace(scene, variables={"first": "2"})
    assert reasons(run_batch(later, DRY)) == ["options changed"] * 3
    (takes / "t.scene.yaml").write_text(SCENE + "    last: 3\n")
    report = run_batch(scene, DRY)
    assert reasons(report) == ["input changed"] * 3
    assert report.items[0].detail == "../t.scene.yaml"


def test_versions(takes: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run_batch(spec(takes), SERIAL)
    newer = {**package_versions(), "usd-core": "99"}
    monkeypatch.setattr("animtool.batch.plan.package_versions", lambda: newer)
    assert reasons(run_batch(spec(takes), DRY)) == ["version changed"] * 3


def test_force(takes: Path) -> None:
    run_batch(spec(takes), SERIAL)
    assert (
        reasons(run_batch(spec(takes), replace(DRY, force=True))) == ["asked for"] * 3
    )


def test_a_dry_run_leaves_nothing(takes: Path) -> None:
    run_batch(spec(takes), DRY)
    assert not (takes / "out").exists()


def test_folders_may_move_together(takes: Path) -> None:
    (takes / "job").mkdir()
    (takes / "takes").rename(takes / "job/takes")
    run_batch(spec(takes / "job"), SERIAL)
    (takes / "job").rename(takes / "moved")
    assert reasons(run_batch(spec(takes / "moved"), DRY)) == ["up to date"] * 3


@pytest.mark.parametrize(("folder", "name"), [("a", "{stem}"), ("b", "{parent}")])
def test_the_hint_for_equal_outputs_names_what_separates_the_inputs(
    tmp_path: Path, folder: str, name: str
) -> None:
    files = [tmp_path / "a" / "x.bvh", tmp_path / folder / "x.bvh"]
    files[1] = files[1].with_stem("y" if folder == "a" else "x")
    for path in files:
        path.parent.mkdir(exist_ok=True)
        path.touch()
    batch = find_batch(BatchSpec(("**/*.bvh",), tmp_path, output="o/out.usdc"))
    with pytest.raises(OptionError) as caught:
        check_output_files(batch)
    assert name in str(caught.value.faults[0].hint)
