"""`python -m fraclink` is the command `fraclink`."""

import sys

from fraclink._cli import main

sys.exit(main())
