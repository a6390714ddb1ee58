"""`python -m defplan_mj` is the command `defplan`."""

import sys

from defplan_mj.cli import main

sys.exit(main())
