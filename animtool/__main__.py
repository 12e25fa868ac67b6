"""``python -m animtool``."""

from animtool.cli.main import main

if __name__ == "__main__":
    main()
