"""`python -m fraclink` is the command `fraclink`."""

import sys

from fraclink import main

sys.exit(main())
