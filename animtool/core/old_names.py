"""Old module names, which plug-ins and scripts may still import."""

from __future__ import annotations

import sys
import warnings
from importlib import import_module
from importlib.machinery import ModuleSpec
from typing import TYPE_CHECKING, Any, cast

if TYPE_CHECKING:
    from collections.abc import Sequence
    from types import ModuleType

OLD_NAMES = {
    "animtool.clock": "animtool.core.clock",
    "animtool.errors": "animtool.core.errors",
    "animtool.markers": "animtool.motion.markers",
    "animtool.mocap": "animtool.capture",
    "animtool.mocap.cameras": "animtool.capture.cameras",
    "animtool.mocap.face": "animtool.capture.face",
    "animtool.mocap.retarget": "animtool.retarget",
    "animtool.passes": "animtool.motion.passes",
    "animtool.readers": "animtool.core.readers",
    "animtool.rules": "animtool.core.rules",
    "animtool.systems.colours": "animtool.systems.framework.colours",
    "animtool.systems.fields": "animtool.systems.framework.fields",
    "animtool.systems.interacting": "animtool.systems.framework.interacting",
    "animtool.systems.kinds": "animtool.systems.framework.kinds",
    "animtool.systems.simulation": "animtool.systems.framework.simulation",
    "animtool.systems.surfaces": "animtool.systems.framework.surfaces",
    "animtool.systems.particles.places": "animtool.systems.particles.emitter_shapes",
    "animtool.take": "animtool.motion.take",
}


def new_name(name: str) -> str | None:
    """Return the new name of an old module or of one below it; None of others."""
    above, _, rest = name.rpartition(".")
    if name in OLD_NAMES or not above:
        return OLD_NAMES.get(name)
    parent = new_name(above)
    return parent and f"{parent}.{rest}"


class _OldNames:
    """Finds moved modules by their old names.

    It has what `importlib.abc` asks of a finder and a loader, which loads 40 modules.
    """

    def create_module(self, _: ModuleSpec) -> None:
        """Leave the creation of modules to Python."""

    def find_spec(
        self, name: str, _path: Sequence[str] | None, _: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Return the spec of an old name; None for any other."""
        if not new_name(name):
            return None
        # From now on first: later finders would find modules below the new name.
        sys.meta_path.remove(cast(Any, self))
        sys.meta_path.insert(0, cast(Any, self))
        return ModuleSpec(name, cast(Any, self))

    def exec_module(self, module: ModuleType) -> None:
        """Replace the module of the old name by that of the new one."""
        new = new_name(module.__name__)
        assert new is not None
        text = f"{module.__name__} is now called {new}"
        warnings.warn(text, DeprecationWarning, stacklevel=2)
        sys.modules[module.__name__] = import_module(new)


# Last: nothing is looked up until an old name is imported.
sys.meta_path.append(cast(Any, _OldNames()))
