"""`python -m benchmarks`: the suite."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

from suite import main

sys.exit(main())
