"""What docs/ gives figures of, measured: run from the project's folder.

`python -m benchmarks` makes the tables of docs/motion.md, a module for each; `time_sync` stands by
itself, on the tests' bench: the real driver side against simulated drives.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent / "test"))
