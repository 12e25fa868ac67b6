"""Cloth of a character that keeps apart from itself."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support.attached import moved, sheet_rig, simulate, simulated, strands_rig, take_of
from support.piercing import distances, pierced

from animtool.core.errors import OptionError
from animtool.maths.faces import triangulate
from animtool.motion.take import Take, TakeStream
from animtool.rig.skeleton import Rig
from animtool.systems.attach.settings import AttachSettings, SimulateOptions

SIZE = 8
EDGE = 0.3 / (SIZE - 1)
THICKNESS = 0.4 * EDGE
# One corner is held, and the rest falls into folds that the post turns in.
RIG = sheet_rig(SIZE, (0,))
OPTIONS = {"settle": 0.0, "bend": 0.5, "diagonals": 5.0, "rate": 2400.0}


def triangles(rig: Rig) -> np.ndarray:
    faces = rig.meshes[0].faces.load().astype(np.int64)
    return triangulate(np.full(len(faces), 4), faces.ravel())


def whirled(seconds: float = 0.8) -> Take:
    def place(t: np.ndarray) -> np.ndarray:
        return 0.1 * np.stack([np.sin(9 * t), 0 * t, np.sin(13 * t)], axis=1)

    def turn(t: np.ndarray) -> np.ndarray:
        return np.stack([0 * t, 6 * np.sin(2 * np.pi * t), 0 * t], axis=1)

    return take_of(RIG, 24, seconds, place, turn)


def crossings(take: Take) -> int:
    return max(pierced(x, triangles(RIG)) for x in moved(take))


@pytest.mark.slow
def test_cloth_in_folds_keeps_its_thickness() -> None:
    found, codes = simulated(whirled(), thickness=f"{THICKNESS}m", **OPTIONS)
    places, corners = moved(found), triangles(RIG)
    near = distances(places[0], places[0][corners]) < 1.5 * THICKNESS
    least = [np.where(near, 1, distances(x, x[corners])).min() for x in places]
    assert min(least) > 0.9 * THICKNESS
    assert codes == ["SIM130"]
    # Without a thickness it has one by its edges; without contact it is in a tangle.
    assert crossings(found) == 0
    assert crossings(simulated(whirled(), **OPTIONS)[0]) == 0
    assert crossings(simulated(whirled(), self_contact=False, **OPTIONS)[0]) > 30


@pytest.mark.slow
def test_in_blocks_or_from_a_saved_frame_it_moves_the_same(tmp_path: Path) -> None:
    path = tmp_path / "states.npz"
    options = {"thickness": f"{THICKNESS}m", **OPTIONS}
    whole, _ = simulated(whirled(), save=str(path), save_at=(9.0,), **options)
    blocks, _ = simulated(whirled(), blocks=4, **options)
    rest, _ = simulated(whirled(), resume=path, **options)
    np.testing.assert_array_equal(moved(blocks), moved(whole))
    np.testing.assert_array_equal(moved(rest)[8:], moved(whole)[8:])


def test_what_went_through_is_saved_and_counted(tmp_path: Path) -> None:
    path = tmp_path / "states.npz"
    take = take_of(RIG, 24, 0.6)
    options = {"gravity": 0.0, "thickness": f"{THICKNESS}m", **OPTIONS}
    simulated(take, save=str(path), save_at=(1.0,), **options)
    with np.load(path) as file:
        arrays = dict(file)
    # Folded in two, one half behind the other, on the side of its normals.
    key = "1.0/flag/state"
    flag = arrays[f"{key}/positions"]
    over = flag[:, 0] > 0.15
    flag[over] = [0.3 + 0.3 * EDGE, 0, -0.8 * THICKNESS] + flag[over] * [-1, 1, 1]
    flag[over, 1] += 0.2 * EDGE
    far = 3 * SIZE - 1
    corners = triangles(RIG)
    apart = distances(flag[[far]], flag[corners])[0]
    near = np.where(over[corners].any(axis=1), 1, apart).argmin()
    arrays[f"{key}/positions"] = flag
    for side in (1, -1):
        passages = [[far, int(near), side]]
        arrays[f"{key}/passages"] = np.array(passages)
        np.savez(path, **arrays)
        again = tmp_path / "again.npz"
        found, codes = simulated(
            take, resume=path, save=str(again), save_at=(1.0,), **options
        )
        assert codes.count("SIM144") == (side == -1)
        with np.load(again) as file:
            assert file[f"{key}/passages"].tolist() == passages
        assert np.isfinite(moved(found)).all()


def test_passages_of_no_cloth_are_refused(tmp_path: Path) -> None:
    """Of a particle that there is none of, or an index beyond what a kernel counts."""
    path = tmp_path / "states.npz"
    take = take_of(RIG, 24, 0.1)
    options = {"gravity": 0.0, "thickness": f"{THICKNESS}m", **OPTIONS}
    simulated(take, save=str(path), save_at=(1.0,), **options)
    with np.load(path) as file:
        arrays = dict(file)
    for passage, refused in (
        ([SIZE * SIZE - 1, 0, 1], False),
        ([SIZE * SIZE, 0, 1], True),
        ([0, 2**31 + 1, 1], True),
        ([0, -(2**31) - 1, 1], True),
    ):
        arrays["1.0/flag/state/passages"] = np.array([passage])
        np.savez(path, **arrays)
        if not refused:
            simulated(take, resume=path, **options)
            continue
        with pytest.raises(OptionError) as error:
            simulated(take, resume=path, **options)
        assert error.value.faults[0].code == "SIM035"


def test_only_cloth_has_a_thickness() -> None:
    options = SimulateOptions(("hair",), thickness="5mm")
    kinds = ("cloth", "strands", "spring_chain")
    assert [AttachSettings.from_options(options, kind).thickness for kind in kinds] == [
        0.005,
        0,
        0,
    ]
    take = take_of(strands_rig(), 24, 0.2)
    thick, _ = simulated(take, thickness="5cm")
    np.testing.assert_array_equal(moved(thick), moved(simulated(take)[0]))


@pytest.mark.parametrize("thickness", ["0mm", "-1cm", "thin"])
def test_a_thickness_that_makes_no_sense(thickness: str) -> None:
    with pytest.raises(OptionError) as caught:
        simulated(take_of(RIG, 24, 0.1), thickness=thickness)
    assert [fault.code for fault in caught.value.faults] == ["SIM004"]


def test_a_cycle_is_measured_with_its_seam() -> None:
    """What is reported is how the written points lie, blended ones too."""
    take = whirled(0.3)
    options = SimulateOptions(("flag",), loop=True, loop_repeats=1, **OPTIONS)
    stream = simulate(TakeStream.of(take), options)
    points = moved(stream.collect()).reshape(-1, SIZE, SIZE, 3)
    lengths = [np.linalg.norm(np.diff(points, axis=axis), axis=-1) for axis in (1, 2)]
    strain = max(float(np.abs(one / EDGE - 1).max()) for one in lengths)
    (report,) = stream.simulated
    assert report["strain"]["value"] == pytest.approx(strain, abs=1e-9)


@pytest.mark.parametrize("repeats", [3, 20])
def test_cloth_that_does_not_come_round_is_steered(repeats: int) -> None:
    """It is no rougher at the seam than elsewhere, and keeps its lengths there."""

    def turn(t: np.ndarray) -> np.ndarray:
        return np.stack([0 * t, 2 * np.sin(2 * np.pi * t), 0 * t], axis=1)

    take = take_of(sheet_rig(6), 24, 23 / 24, turn=turn)
    options = SimulateOptions(("flag",), loop=True, loop_repeats=repeats, drag=0.1)
    stream = simulate(TakeStream.of(take), options)
    points = moved(stream.collect())
    codes = {notice.code for notice in stream.notices}
    assert not codes & {"SIM133", "SIM180", "SIM181", "SIM182"}
    (report,) = stream.simulated
    assert report["strain"]["value"] < 0.08
    assert report["pierced"]["value"] == 0
    changes = points - 2 * np.roll(points, 1, axis=0) + np.roll(points, -1, axis=0)
    sizes = np.linalg.norm(changes, axis=2).max(axis=1)
    assert max(sizes[0], sizes[-1]) <= sizes[1:-1].max()
