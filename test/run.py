"""All tests, as `make test` runs them: `python test/run.py [arguments of pytest]`.

Those that compute run side by side on all cores; then those that run in real time, with processes
and buses of their own and mostly waiting, two files at a time, as more would have to wait for each
other; then those on SocketCAN, one after another, in one guest where this kernel has none.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Sequence

NO_TESTS = 5  # pytest's status when none was selected
PHASES = (
    ("-n", "auto", "--dist", "worksteal", "-m", "not realtime and not socketcan"),
    ("-n", "2", "--dist", "loadfile", "-m", "realtime and not socketcan"),
    ("-m", "socketcan"),
)


def main(arguments: Sequence[str]) -> int:
    """The status of the first phase that failed; that of pytest without tests if none was run."""
    statuses = [
        subprocess.run([sys.executable, "-m", "pytest", *phase, *arguments]).returncode
        for phase in PHASES
    ]
    failed = [status for status in statuses if status not in (0, NO_TESTS)]
    if failed:
        return failed[0]
    return 0 if 0 in statuses else NO_TESTS


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
