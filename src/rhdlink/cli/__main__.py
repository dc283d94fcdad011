"""`python -m rhdlink.cli`: the `rhdlink` command, for systems on which it is not on the path."""

import sys

from . import main

if __name__ == "__main__":
    sys.exit(main())
