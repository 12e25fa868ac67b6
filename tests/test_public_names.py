"""Names that a user of the Python interface types."""

from __future__ import annotations

import subprocess
import sys
import warnings
from importlib import import_module
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path

import pytest

import animtool
from animtool.core.old_names import OLD_NAMES

FACES = ("animtool", "animtool.edit", "animtool.ik", "animtool.sim", "animtool.usd")
NAMESPACES = {"edit", "ik", "sim", "usd"}


@pytest.mark.parametrize("face", FACES)
def test_public_names_alone_are_listed_and_exist(face: str) -> None:
    module = import_module(face)
    assert dir(module) == sorted(module.__all__)
    assert all(hasattr(module, name) for name in module.__all__)
    with pytest.raises(AttributeError, match="no attribute 'maltese'"):
        _ = module.maltese


def test_the_package_has_a_version() -> None:
    assert animtool.__version__ == version("animtool")


@pytest.mark.parametrize("face", FACES)
def test_no_module_takes_the_place_of_a_public_name(face: str) -> None:
    module = import_module(face)
    modules = {path.stem for path in Path(str(module.__file__)).parent.iterdir()}
    names = {
        name for name in module.__all__ if name not in {"edit", "ik", "sim", "usd"}
    }
    assert not names & modules


@pytest.mark.parametrize(
    ("old", "new"),
    [*OLD_NAMES.items(), ("animtool.mocap.markers", "animtool.capture.markers")],
)
def test_modules_that_were_moved_have_their_old_names_too(old: str, new: str) -> None:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        assert reload_name(old) is import_module(new)
    assert caught[-1].category is DeprecationWarning
    assert new in str(caught[-1].message)


def reload_name(name: str) -> object:
    """Import a module as if it had not been."""
    sys.modules.pop(name, None)
    return import_module(name)


@pytest.mark.slow(seconds=20)
def test_a_script_of_a_user_passes_pyright(root: Path) -> None:
    if find_spec("pyright") is None:
        pytest.skip("pyright is not installed: pip install 'animtool[types]'")
    command = [sys.executable, "-m", "pyright", "--pythonpath", sys.executable]
    done = subprocess.run(
        command, cwd=root, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout
