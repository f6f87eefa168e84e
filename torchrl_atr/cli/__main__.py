"""``python -m torchrl_atr.cli``."""

import sys

from torchrl_atr.cli import main

sys.exit(main())
