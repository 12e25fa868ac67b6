"""The entry of the command line, and of ``python -m animtool``."""

from __future__ import annotations

import signal
import sys
from types import ModuleType

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import NoReturn

# Allocations between garbage collections of the youngest objects: loading allocates
# many objects and frees hardly any.
GC_YOUNG_THRESHOLD = 200_000
PLUGIN_LOADER = "pydantic.plugin._loader"


class NoPlugins(ModuleType):
    """Pydantic's loader of plug-ins, without any.

    The real module imports `importlib.metadata`, with 50 other modules. It replaces
    this one as soon as something else of it is used.
    """

    @staticmethod
    def get_plugins() -> tuple[()]:
        """Return no plug-ins."""
        return ()

    def __getattr__(self, name: str) -> object:
        """Return an attribute of the real module."""
        if name.startswith("__"):
            raise AttributeError(name)
        import importlib

        del sys.modules[PLUGIN_LOADER]
        attribute: object = getattr(importlib.import_module(PLUGIN_LOADER), name)
        return attribute


def main() -> NoReturn:
    """Run the command line; signals are handled even while its modules are imported."""
    if hasattr(signal, "pthread_sigmask"):
        # Until there is somebody to obey them.
        signals = {signal.SIGINT, signal.SIGTERM, signal.SIGHUP}
        signal.pthread_sigmask(signal.SIG_BLOCK, signals)
    import gc
    import os

    gc.set_threshold(GC_YOUNG_THRESHOLD)
    # Plug-ins of pydantic have no say in what files mean: none is searched for.
    if os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__") == "__all__":
        sys.modules[PLUGIN_LOADER] = NoPlugins(PLUGIN_LOADER)
    try:
        from animtool.cli.main import main as run
    except KeyboardInterrupt:
        sys.stderr.write("interrupted\n")
        sys.exit(130)
    run()


if __name__ == "__main__":
    main()
