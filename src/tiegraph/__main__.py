"""`python -m tiegraph ...` is `tiegraph ...`."""

import sys

from tiegraph.cli.main import main

if __name__ == "__main__":
    sys.exit(main())
