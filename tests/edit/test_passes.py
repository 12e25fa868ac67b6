"""What every pass of the table owes, whatever it does."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from support.small_takes import content, small

from animtool.errors import OptionError
from animtool.formats.bvh import read_bvh
from animtool.passes import PASSES, PassContext, apply_pass, find_pass
from animtool.take import Take, TakeStream

OPTIONS: dict[str, dict[str, Any]] = {
    "trim": {"first": 1, "last": 9},
    "time_scale": {"speed": 0.7},
    "time_warp": {"curve": ((1, 1), (20, 1))},
    "layer": {"take": Path("other"), "weight": ((1, 0), (9, 1))},
    "blend": {"take": Path("other"), "weight": 0.3},
    "resample": {"fps": 24},
    "difference": {"base": Path("other")},
    "loop": {"first": 2, "last": 9, "repeats": 2},
}


def targets_of(take: Take, folder: Path) -> Path:
    """Write targets that hold a joint of a take for some frames."""
    joint = take.rig.joints[take.rig.index("arm_l") if "arm_l" in take.rig.names else 2]
    path = folder / "hold.targets.yaml"
    goal = f"{{effector: {joint.name}, offset: [0.1, 0, 0], hold: [[3, 6]], ease: 1}}"
    path.write_text(f"targets: animtool/1\nunits: {{length: m}}\ngoals: [{goal}]\n")
    return path


def run(name: str, take: Take, /, blocks: int = 1, **options: Any) -> Take:
    """Return a take with a pass of the table applied, the other being itself."""
    with tempfile.TemporaryDirectory() as folder:
        if name == "ik":
            options = {"targets": targets_of(take, Path(folder)), **options}
        return applied(name, take, blocks, options)


def applied(name: str, take: Take, blocks: int, options: dict[str, Any]) -> Take:
    context = PassContext(lambda _: take, Path())
    found = find_pass(name)
    stream = TakeStream.of(take)
    parts = np.array_split(np.arange(take.clock.count), blocks)
    stream.blocks = iter([take.motion.select(part) for part in parts if len(part)])
    settings = found.options(**(OPTIONS.get(name, {}) | options))
    return apply_pass(stream, found, settings, context).collect()


@pytest.fixture(params=["small", "walk"])
def take(request: pytest.FixtureRequest, walk: Path) -> Take:
    return small() if request.param == "small" else read_bvh(walk).collect()


@pytest.mark.parametrize("name", PASSES)
def test_every_pass(name: str, take: Take) -> None:
    before = content(take)
    found = run(name, take)
    assert content(take) == before
    assert content(found) == content(run(name, take))
    assert found.clock.count == found.motion.frames
    translations, rotations, _ = found.motion.dense()
    assert np.isfinite(translations).all()
    np.testing.assert_allclose(np.linalg.norm(rotations, axis=-1), 1, atol=1e-12)
    assert (np.sum(rotations[1:] * rotations[:-1], axis=-1) >= 0).all()


@pytest.mark.parametrize("name", PASSES)
def test_blocks_do_not_show(name: str) -> None:
    one, three = run(name, small()), run(name, small(), blocks=3)
    assert_array_equal(one.motion.rotations.dense(), three.motion.rotations.dense())
    assert_array_equal(
        one.motion.translations.dense(), three.motion.translations.dense()
    )


@pytest.mark.parametrize("name", PASSES)
def test_a_single_frame(name: str) -> None:
    options = {"curve": ((1, 1), (3, 1))} if name == "time_warp" else {}
    assert run(name, small(1), **options).clock.count >= 1


@pytest.mark.parametrize("name", [n for n in PASSES if n != "mirror"])
def test_what_is_static_stays_static(name: str) -> None:
    found = run(name, small())
    assert found.rig.index("arm_r") not in found.motion.rotations.animated


def test_a_name_that_is_nearly_right() -> None:
    with pytest.raises(OptionError, match="time_warp") as error:
        find_pass("time_wrap")
    assert error.value.code == "SCN010"


def test_twice_as_fast_is_every_other_frame() -> None:
    from animtool.edit.time_scale import time_scale

    found = time_scale(small(), 2.0)
    source = small().motion.rotations.dense()[::2]
    assert_array_equal(found.motion.rotations.dense(), source)
