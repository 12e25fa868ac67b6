"""The entry of the command line, and of ``python -m animtool``."""

import gc
import os
import sys
from typing import NoReturn

# Objects made before the youngest are looked through for circles: loading makes many,
# of which hardly any is let go.
YOUNGEST = 200_000


def main() -> NoReturn:
    """Run the command line; an interrupt while it is loaded ends it like any other."""
    gc.set_threshold(YOUNGEST)
    # Plug-ins of pydantic have no say in what files mean: none is searched for.
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
    try:
        from animtool.cli.main import main as run
    except KeyboardInterrupt:
        sys.stderr.write("interrupted\n")
        sys.exit(130)
    try:
        run()
    finally:
        # What is left is not looked through for circles once more at the very end.
        gc.freeze()


if __name__ == "__main__":
    main()
