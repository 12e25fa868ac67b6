"""What loops over springs refuse, by the name of the argument."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from fuzz.kernels.springs import CALLS
from fuzz.targets.kernels import call

from animtool import _kernels
from animtool.systems.springs.body import PrescribedMotion, SpringForces, Springs

HUGE = 2**31 - 1
BAD: list[tuple[str, str, Any]] = [
    ("SpringNetwork", "inverse_masses", -1.0),
    ("SpringNetwork", "rest", -1.0),
    ("SpringNetwork", "stiffness", np.inf),
    ("SpringNetwork", "damping", np.nan),
    ("SpringNetwork", "limit", np.nan),
    ("SpringNetwork", "gravity", np.inf),
    ("SpringNetwork", "air_drag", np.nan),
    ("SpringNetwork", "air_lift", np.inf),
    ("SpringNetwork", "anchor_stiffness", np.nan),
    ("SpringNetwork", "anchor_damping", np.inf),
    ("SpringNetwork", "ends", -1),
    ("SpringNetwork", "triangles", -1),
    ("SpringNetwork", "triangles", 10**6),
    ("SpringNetwork", "pinned_path", np.inf),
    ("SpringNetwork", "winds", np.nan),
    ("SpringNetwork.set_paths", "pinned_path", np.nan),
    ("SpringLayers", "rest_positions", np.nan),
    ("SpringLayers", "thickness", 0.0),
    ("SpringLayers", "separation_speed", np.nan),
    ("SpringLayers.distance", "triangle", 10**9),
    ("SpringLayers.distance", "particle", -5),
    ("SpringLayers.edge_distance", "first", 10**9),
    ("SpringLayers.edge_distance", "second", -1),
    ("SpringStrands", "rests", np.nan),
    ("SpringStrands", "gravity", np.inf),
    ("SpringStrands", "draw_damping", -1.0),
    ("follow_strands", "state", np.nan),
    ("follow_strands", "targets", np.inf),
    ("follow_strands", "frame_duration", 0.0),
    ("follow_strands", "substeps", 0),
    ("follow_strands", "substeps", HUGE),
    ("follow_strands", "thread_count", 0),
    ("part_springs", "h", 0.0),
    ("pierced_edges", "triangles", -1),
    ("spring_order", "particles", 2**62),
    ("spring_order", "ends", -1),
    ("spring_accelerations", "t", np.nan),
    ("spring_accelerations", "is_torn", 7),
    *[
        (name, argument, value)
        for name in ("step_springs", "project_springs", "solve_springs")
        for argument, value in (
            ("state", np.nan),
            ("origin", np.nan),
            ("first_interval", 2**62),
            ("interval_duration", 0.0),
            ("interval_duration", 5e-324),
            ("interval_count", -1),
            ("interval_count", 2**62),
            ("substeps", 0),
            ("substeps", HUGE),
        )
    ],
    ("project_springs", "min_substeps", 0),
    ("project_springs", "max_substeps", HUGE),
    ("project_springs", "low_strain_count", -1),
    ("project_springs", "repeat_strain", np.nan),
    ("project_springs", "initial_intersections", -(2**63)),
    ("solve_springs", "tolerance", 0.0),
    ("solve_springs", "earlier_state", np.nan),
]


def arguments(name: str, argument: str) -> dict[str, Any]:
    """Return valid arguments of which one has something in it."""
    for seed in range(100):
        made = CALLS[name](np.random.default_rng(seed))
        value = made[argument]
        if value is not None and (not isinstance(value, np.ndarray) or value.size):
            return made
    raise AssertionError


@pytest.mark.parametrize(("name", "argument", "bad"), BAD)
def test_what_cannot_be_is_refused_by_its_name(
    name: str, argument: str, bad: float
) -> None:
    made = arguments(name, argument)
    value = bad
    if isinstance(made[argument], np.ndarray):
        value = made[argument].copy()
        value.flat[-1] = bad
    with pytest.raises(ValueError, match=f"^{argument}"):
        call(name, {**made, argument: value})


def test_times_that_descend_are_refused() -> None:
    made = CALLS["SpringNetwork"](np.random.default_rng(0))
    paths = {name: made[name][:1] for name in ("pinned_path", "anchor_path", "winds")}
    with pytest.raises(ValueError, match=r"^knots: it does not ascend at index 1"):
        _kernels.SpringNetwork(**{**made, **paths, "knots": np.array([3.0, 0, 2])})


def test_a_path_that_does_not_fit_changes_nothing() -> None:
    every = (CALLS["SpringNetwork"](np.random.default_rng(i)) for i in range(100))
    made = next(one for one in every if len(one["pinned"]) and len(one["anchors"]))
    network, whole = (
        _kernels.SpringNetwork(**made),
        np.zeros(len(made["ends"]), np.uint8),
    )
    state = np.zeros((2, len(made["drags"]), 3))

    def stepped() -> bytes:
        found = _kernels.step_springs(network, state, whole, 0.0, 0, 0.01, 1, 1, None)
        return bytes(found[0].tobytes())

    begun = stepped()
    with pytest.raises(ValueError, match=r"^anchor_path"):
        network.set_paths(made["pinned_path"] + 1, made["anchor_path"][:, :-1].copy())
    assert stepped() == begun


def test_layers_are_of_as_many_particles() -> None:
    made = CALLS["part_springs"](np.random.default_rng(1))
    for seed in range(2, 20):
        other = CALLS["part_springs"](np.random.default_rng(seed))
        if len(other["before"]) != len(made["before"]):
            break
    with pytest.raises(ValueError, match=r"^layers"):
        call("part_springs", {**made, "layers": other["layers"]})


def test_no_particles_keep_apart() -> None:
    nothing, none = np.zeros((1, 0, 3)), np.zeros((0, 3), np.int64)
    loads = SpringForces(
        np.zeros(0), np.zeros(0), Springs.none(), none, np.zeros(3), (0, 0)
    )
    wind = np.zeros((1, 1, 3))
    network = loads.network(PrescribedMotion(np.zeros(1), nothing, nothing, wind))
    layers = _kernels.SpringLayers(network, np.zeros((0, 3)), 0.1, 0.0, 0.1)
    state = np.zeros((2, 0, 3))
    found = _kernels.part_springs(network, layers, state[0], state, 0.1)
    assert found.shape == (2, 0, 3)


def test_a_surface_that_is_none_is_refused() -> None:
    made = arguments("step_springs", "state")
    poses = np.zeros((made["interval_count"], 0, 2, 7))
    rng = np.random.default_rng(0)
    arrays = CALLS["step_springs"](rng)["colliders"]
    while arrays is None or len(arrays[0][0]):
        arrays = CALLS["step_springs"](rng)["colliders"]
    moving = [(None, np.zeros((1, 3, 3)), [0.0] * 5, 1, 0)]
    met = (arrays[0], poses, 0.0, None, 0.0, moving)
    with pytest.raises(ValueError, match=r"^colliders.surfaces"):
        call("step_springs", {**made, "colliders": met})


@pytest.mark.parametrize("value", [1e200, 1e308, 5e-324])
def test_places_that_are_far_off_end_the_call(value: float) -> None:
    rng = np.random.default_rng(4)
    made = CALLS["project_springs"](rng)
    while (
        made["layers"] is None
        or not made["interval_count"]
        or made["initial_intersections"].size == 0
    ):
        made = CALLS["project_springs"](rng)
    made["state"][0, ::2] = value
    made["state"][0, 1] = -value
    found = call("project_springs", made)
    assert found[0].shape == made["state"].shape
