"""The entry of the command line, and of ``python -m animtool``."""

import gc
import sys
from typing import NoReturn

# Objects made before the youngest are looked through for circles: loading makes many,
# of which hardly any is let go.
YOUNGEST = 200_000


def main() -> NoReturn:
    """Run the command line; an interrupt while it is loaded ends it like any other."""
    try:
        gc.set_threshold(YOUNGEST)
        from animtool.cli.main import main as run
    except KeyboardInterrupt:
        sys.stderr.write("interrupted\n")
        sys.exit(130)
    run()


if __name__ == "__main__":
    main()
