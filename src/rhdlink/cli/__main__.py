"""`python -m rhdlink.cli` runs the `rhdlink` command on systems on which the command is not on the path."""

import sys

from . import main

if __name__ == "__main__":
    sys.exit(main())
