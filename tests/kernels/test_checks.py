"""Arguments that crash, hang or give numbers without sense are refused by name."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from fuzz.kernels.curves import rotations
from fuzz.kernels.ik import Problem

from animtool import _kernels

NAN, INF = np.nan, np.inf
POINTS = np.random.default_rng(0).normal(size=(30, 3))
TRIANGLES = np.random.default_rng(1).integers(0, 30, (40, 3), dtype=np.int32)
STILL = np.array([[[0, 0, 0, 0, 0, 0, 1.0]] * 2])


@pytest.mark.parametrize("axes", [[34, 32, 33], [-32, -31, -30], [0, 1, 1]])
def test_axes_are_three(axes: list[int]) -> None:
    one = np.array([[[0, 0, 0, 1.0]]])
    with pytest.raises(ValueError, match=r"^axes: "):
        _kernels.quaternion_to_euler(one, np.array([axes], np.int32))


def test_columns_are_those_of_the_values() -> None:
    def turned(column: int) -> Any:
        columns = np.array([[column, -1, -1]], np.int32)
        axes = np.zeros((1, 3), np.int32)
        return _kernels.euler_to_quaternion(
            np.zeros((2, 1)), columns, axes, np.eye(4)[3:]
        )

    assert turned(-1).shape == (2, 1, 4)
    for column in (-2, 1):
        with pytest.raises(ValueError, match=rf"^columns: {column} is not between -1"):
            turned(column)


def curves(times: list[float], kind: int = 1, handle: float = 0.0) -> Any:
    keys = len(times)
    return _kernels.evaluate_curves(
        np.array([0, keys]),
        np.array(times),
        np.zeros(keys),
        np.full(keys, kind),
        np.zeros((keys, 2)),
        np.full((keys, 2), handle),
        np.linspace(-1, 10, 30)[None],
    )


@pytest.mark.parametrize(
    ("times", "kind", "handle", "name"),
    [
        ([0, NAN, 2], 1, 0, "times"),
        ([-INF, 0, INF], 1, 0, "times"),
        ([-1e308, 1e308, 1.5e308], 1, 0, "times"),
        ([0, 5, 1, 9], 1, 0, "times"),
        ([0, 1, 1, 2], 1, 0, "times"),
        ([0, 1, 2], 3, NAN, "outs"),
        ([0, 1, 2], 4, 0, "kinds"),
        ([0, 1, 2], -1, 0, "kinds"),
    ],
)
def test_curves_without_end(
    times: list[float], kind: int, handle: float, name: str
) -> None:
    assert curves([0.0, 1.0, 1.5, 2.0]).shape == (1, 30)
    with pytest.raises(ValueError, match=rf"^{name}: "):
        curves(times, kind, handle)


def test_samples_that_are_not_finite_do_not_rest() -> None:
    none = np.zeros(0, np.int64)
    rest = none, np.full(2, -INF), np.full(2, INF), none
    for bad in (NAN, INF):
        with pytest.raises(ValueError, match=r"^values: "):
            _kernels.fit_cubics(np.full((9, 2), bad), np.ones(9), *rest)
        with pytest.raises(ValueError, match=r"^bounds: "):
            _kernels.fit_cubics(np.zeros((9, 2)), np.full(9, bad), *rest)


@pytest.mark.parametrize("columns", [2**31, 2**61, 2**63])
def test_rows_are_not_endless(columns: int) -> None:
    with pytest.raises(ValueError, match=r"^columns: "):
        _kernels.parse_bvh_rows(b"1 2\n", columns, 5, True)
    read = _kernels.parse_bvh_rows(b"1 2\n", 2**31 - 1, 5, True)
    assert read[0].shape == (0, 2**31 - 1)
    assert read[4:6] == (1, 2)


@pytest.mark.parametrize("parents", [[-1, -2], [0, 0], [-1, 2**62]])
def test_parents_are_before_their_children(parents: list[int]) -> None:
    with pytest.raises(ValueError, match=r"^parents: "):
        _kernels.forward_kinematics(
            np.array(parents),
            np.zeros((1, 2, 3)),
            np.ones((1, 2, 4)),
            None,
            np.zeros((1, 2, 3)),
            np.zeros((1, 2, 3, 3)),
        )


def test_numbers_are_where_their_type_may_be() -> None:
    apart = np.zeros(49, np.uint8)[1:].view(np.float64).reshape(1, 2, 3)
    with pytest.raises(ValueError, match="points: the array is not aligned"):
        _kernels.point_extents(apart)


def test_points_of_meshes_are_finite() -> None:
    for make in (_kernels.build_mesh_tree, _kernels.MeshSurface):
        for bad in (NAN, INF):
            with pytest.raises(ValueError, match=r"^points: .* index 4 "):
                make(
                    np.where(np.arange(90).reshape(30, 3) == 4, bad, POINTS), TRIANGLES
                )
        for corner in (-1, 30, -(2**31), 2**31 - 1):
            bad_corner = np.array([[0, 1, corner]], np.int32)
            with pytest.raises(ValueError, match=rf"^triangles: {corner} is not"):
                make(POINTS, bad_corner)


def sampled(spoil: Callable[[list[Any]], None]) -> Any:
    tree = list(_kernels.build_mesh_tree(POINTS, TRIANGLES))
    spoil(tree)
    kinds, materials = np.array([[4, 0, 0]]), np.ones((1, 4))
    colliders = (kinds, np.ones((1, 7)), materials, STILL, POINTS, *tree)
    return _kernels.sample_colliders(colliders, POINTS + 0.1, 0.0, 0.1)


def node(row: int, values: list[int]) -> Callable[[list[Any]], None]:
    def spoil(tree: list[Any]) -> None:
        tree[4][row] = values

    return spoil


def corners(value: int) -> Callable[[list[Any]], None]:
    def spoil(tree: list[Any]) -> None:
        tree[0][:] = value

    return spoil


def ladder(tree: list[Any]) -> None:
    """Every node has the next one twice: each way down is another."""
    rows = [[i + 1, i + 1] for i in range(60)]
    tree[4] = np.array([*rows, [-1, 1]], np.int32)
    tree[3] = np.tile([-9.0, -9, -9, 9, 9, 9], (61, 1))


def deep(tree: list[Any]) -> None:
    rows = [[i + 1, 100 + i] for i in range(99)]
    tree[4] = np.array([*rows, [-1, 1], *[[-1, 1]] * 99], np.int32)
    tree[3] = np.tile([-9.0, -9, -9, 9, 9, 9], (199, 1))


@pytest.mark.parametrize(
    ("spoil", "name"),
    [
        (node(0, [0, 0]), "nodes"),
        (node(0, [10**6, 10**6]), "nodes"),
        (node(-1, [-1, 10**7]), "nodes"),
        (node(-1, [-1, -1]), "nodes"),
        (node(-1, [-(2**31), 2**31 - 1]), "nodes"),
        (ladder, "nodes"),
        (deep, "nodes"),
        (corners(10**8), "triangles"),
        (corners(-(10**8)), "triangles"),
    ],
)
def test_trees_have_an_end(spoil: Callable[[list[Any]], None], name: str) -> None:
    assert np.isfinite(sampled(lambda _: None)[0]).all()
    with pytest.raises(ValueError, match=rf"^{name}: "):
        sampled(spoil)


def test_colliders_are_of_known_kinds() -> None:
    def look(kind: list[int], size: float = 1.0, share: float = 0.0) -> None:
        tree = _kernels.build_mesh_tree(POINTS, TRIANGLES)
        kinds, sizes = np.array([kind]), np.full((1, 7), size)
        colliders = (kinds, sizes, np.ones((1, 4)), STILL, POINTS, *tree)
        _kernels.sample_colliders(colliders, POINTS, share, 0.1)

    look([1, 0, -1])
    for kind in ([5, 0, 0], [-1, 0, 0], [4, 0, -1], [4, 0, 10**6]):
        with pytest.raises(ValueError, match=r"^kinds: "):
            look(kind)
    with pytest.raises(ValueError, match=r"^sizes: "):
        look([1, 0, 0], NAN)
    with pytest.raises(ValueError, match=r"^fraction: "):
        look([1, 0, 0], share=1e300)


def problem(goals: int = 2) -> dict[str, Any]:
    """Return two pins and goals on the second."""
    numbers = np.zeros((2, 18))
    numbers[:, :9] = np.eye(3).reshape(-1)
    numbers[1, 9] = 0.5
    numbers[:, 12] = 1
    numbers[:, 14:16] = [-INF, INF]
    goal_numbers = np.zeros((goals, 13))
    goal_numbers[:, [0, 9]] = [0.5, 1]
    targets = np.zeros((1, goals, 17))
    targets[..., 6] = 1
    targets[..., 13:] = 1
    return {
        "nodes": np.array([[0, -1, 0, 0], [0, 0, 1, 0]]),
        "numbers": numbers,
        "goals": np.tile([1, -1, -1, 0], (goals, 1)),
        "goal_numbers": goal_numbers,
        "starts": np.zeros((1, 2)),
        "targets": targets,
        "reachable": targets.copy(),
        "stretches": np.ones((1, goals)),
        "rests": np.zeros((1, 2)),
        "rest_weight": 0.0,
        "length_tolerance": 1e-6,
        "angle_tolerance": 1e-6,
        "damping": 1e-3,
        "iterations": 50,
        "restarts": 2,
        "seed": 1,
        "seconds": 0.0,
        "ordered": False,
        "warm": False,
        "method": 0,
    }


def changed(array: Any, at: Any, value: float) -> Any:
    array = array.copy()
    array[at] = value
    return array


GIVEN = problem()


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("iterations", -1),
        ("restarts", -5),
        ("seconds", NAN),
        ("seconds", -1.0),
        ("method", 5),
        ("damping", NAN),
        ("length_tolerance", -1.0),
        ("rest_weight", NAN),
        ("nodes", changed(GIVEN["nodes"], (1, 1), 1)),
        ("nodes", changed(GIVEN["nodes"], (1, 1), -2)),
        ("nodes", changed(GIVEN["nodes"], (1, 0), 3)),
        ("nodes", changed(GIVEN["nodes"], (1, 2), 7)),
        ("nodes", np.array([[0, -1, 0, 0], [2, 0, 0, 1]])),
        ("numbers", changed(GIVEN["numbers"], (0, 9), NAN)),
        ("numbers", changed(GIVEN["numbers"], (0, 14), NAN)),
        ("numbers", changed(changed(GIVEN["numbers"], (0, 14), 2), (0, 15), -2)),
        ("goals", changed(GIVEN["goals"], (0, 0), 2)),
        ("goals", changed(GIVEN["goals"], (0, 1), -9)),
        ("goals", changed(GIVEN["goals"], (0, 3), 2)),
        ("goal_numbers", changed(GIVEN["goal_numbers"], (0, 9), -1)),
        ("goal_numbers", changed(GIVEN["goal_numbers"], (0, 0), INF)),
        ("targets", changed(GIVEN["targets"], (0, 0, 13), -1)),
        ("reachable", changed(GIVEN["reachable"], (0, 0, 13), NAN)),
        ("stretches", np.ones((1, 3))),
        ("starts", np.ones((2, 2))),
    ],
)
def test_problems_that_make_no_sense(name: str, value: object) -> None:
    with pytest.raises(ValueError, match=rf"^({name}|numbers|rests): "):
        _kernels.solve_ik(**{**GIVEN, name: value})


def test_fabrik_has_no_slides() -> None:
    given = {**GIVEN, "nodes": changed(GIVEN["nodes"], (1, 0), 1)}
    assert _kernels.solve_ik(**{**given, "method": 3})[0].shape == (1, 2)
    with pytest.raises(ValueError, match=r"^method: FABRIK"):
        _kernels.solve_ik(**{**given, "method": 4})


def test_targets_beyond_numbers_are_an_outcome() -> None:
    for bad in (NAN, INF, 1e300):
        targets = changed(GIVEN["targets"], (0, 0, 0), bad)
        found = _kernels.solve_ik(**{**GIVEN, "targets": targets, "reachable": targets})
        assert found[2][0, 0] == 3
        assert np.isfinite(found[0]).all()


def test_negative_weights_write_no_rows() -> None:
    given = problem(goals=50)
    given["goal_numbers"][:, 9:] = -1
    given["targets"][..., 13:] = -1
    with pytest.raises(ValueError, match=r"^goal_numbers: "):
        _kernels.solve_ik(**{**given, "reachable": given["targets"]})


def test_a_way_needs_a_path() -> None:
    rng = np.random.default_rng(0)
    chain = Problem(rng)
    frames = 2000
    with pytest.raises(ValueError, match=r"^paths: the array is empty"):
        _kernels.cheapest_ik_path(
            **chain.chain,
            paths=np.zeros((0, frames, chain.coordinates)),
            costs=np.zeros((0, frames)),
            drifts=np.zeros((frames - 1, chain.dofs)),
            free_step=np.ones(frames - 1),
            allows_any_start=False,
            must_end_on_first=False,
        )


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *(("acceleration", NAN), ("anchor", 0.0), ("end", 9), ("first", 2)),
        *(("rounds", -1), ("robust", 0.0), ("robust", NAN), ("homing", 2.0)),
        *(("iterations", -1), ("rest_weight", -1.0), ("starts", np.zeros((2, 2)))),
    ],
)
def test_fitting_needs_weights_and_frames(name: str, value: object) -> None:
    given = {key: GIVEN[key] for key in ("nodes", "numbers", "goals", "goal_numbers")}
    given |= {"targets": GIVEN["targets"], "path": np.zeros((1, 2))}
    given |= {"starts": np.zeros((1, 2)), "anchor": 1.0, "speed": 0.0}
    given |= {"acceleration": 1.0, "robust": 8.0, "rest_weight": 1.0, "homing": 0.1}
    given |= {"first": 0, "end": 1, "iterations": 9, "rounds": 2, "tracked": True}
    assert _kernels.fit_ik(**given)[0].shape == (1, 2)
    for bad in (NAN, np.inf, 1e300):
        spoiled = np.full_like(GIVEN["targets"], 1.0)
        spoiled[..., 0] = bad
        assert _kernels.fit_ik(**{**given, "targets": spoiled})[0].shape == (1, 2)
        assert _kernels.fit_ik(**{**given, "path": np.full((1, 2), bad)})
    with pytest.raises(ValueError, match=rf"^{name}: "):
        _kernels.fit_ik(**{**given, name: value})


@pytest.mark.parametrize(
    ("name", "value"),
    [("acceleration", NAN), ("anchor", -1.0), ("end", 9), ("first", 2), ("rounds", -1)],
)
def test_smoothing_needs_weights_and_frames(name: str, value: float) -> None:
    given = {key: GIVEN[key] for key in ("nodes", "numbers", "goals", "goal_numbers")}
    given |= {key: GIVEN[key] for key in ("targets", "reachable", "stretches")}
    given |= {"path": np.zeros((1, 2)), "drifts": np.zeros((0, 2)), "anchor": 1.0}
    given |= {"speed": 1.0, "acceleration": 1.0, "first": 0, "end": 1, "rounds": 1}
    given |= {"length_tolerance": 1e-6, "angle_tolerance": 1e-6, "damping": 1e-6}
    assert _kernels.smooth_ik(**given)[0].shape == (1, 2)
    with pytest.raises(ValueError, match=rf"^{name}: "):
        _kernels.smooth_ik(**{**given, name: value})


def test_units_and_lengths_are_finite() -> None:
    for unit in (0.0, NAN, INF, -1.0):
        with pytest.raises(ValueError, match=r"^unit: "):
            _kernels.round_points(np.ones((1, 1, 3)), unit)
        with pytest.raises(ValueError, match=r"^length: "):
            _kernels.to_chain_targets(
                np.ones((1, 1, 17)), rotations(np.random.default_rng(0), 1), unit
            )
