"""What docs/ gives figures of, measured: run from the project's folder.

`python -m benchmarks` makes the tables of docs/motion.md, a module for each. `time_sync`,
`bus_load`, `driver_cpu`, `feeding` and `buslog` run by themselves, on the tests' bench or with the
driver.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent / "test"))
