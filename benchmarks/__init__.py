"""What docs/ gives figures of, measured: `python -m benchmarks.<name>` from the project's folder.

The benchmarks run on the tests' bench: the real driver side against simulated drives.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent / "test"))
