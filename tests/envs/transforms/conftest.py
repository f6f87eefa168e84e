from __future__ import annotations

import sys
from pathlib import Path

# the toy environment must be importable by name, in worker processes too
sys.path.insert(0, str(Path(__file__).parent))
