"""The entry of the command line, and of ``python -m animtool``."""

from __future__ import annotations

import signal
import sys

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import NoReturn

# Allocations between garbage collections of the youngest objects: loading allocates
# many objects and frees hardly any.
GC_YOUNG_THRESHOLD = 200_000


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
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
    try:
        from animtool.cli.main import main as run
    except KeyboardInterrupt:
        sys.stderr.write("interrupted\n")
        sys.exit(130)
    run()


if __name__ == "__main__":
    main()
