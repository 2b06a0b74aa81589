"""``python -m learn2assemble`` is ``l2a``."""

import sys

from learn2assemble.cli import main

sys.exit(main())
