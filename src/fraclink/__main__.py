"""`python -m fraclink` is the command `fraclink`."""

import sys

from fraclink.cli import main

sys.exit(main())
