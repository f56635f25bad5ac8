"""Real time, where the system gives it: SCHED_FIFO for a thread, memory that stays.

A thread with SCHED_FIFO runs before all ordinary ones and goes on until it waits, so one that never
waited would keep a processor from everybody else. Linux takes it away for 50 ms of a second unless
somebody has switched that off (`kernel.sched_rt_runtime_us`); here a thread that has hardly waited
for a tenth of a second goes on as an ordinary one until it has.

Threads that such a thread starts are ordinary: what they run is not meant to be urgent.
"""

from __future__ import annotations

import ctypes
import os
import resource
import time
from pathlib import Path

WINDOW_NS = 100_000_000
SHARE = 0.9  # of the window, that a thread may compute in
DO = (
    "to have it, make a group realtime with you in it, put '@realtime - rtprio 99' and "
    "'@realtime - memlock unlimited' into /etc/security/limits.d/realtime.conf and log in again "
    "(docs/realtime.md has services and containers; realtime.priority 0 goes without)"
)
_CAP_IPC_LOCK = 14  # linux/capability.h
# sys/mman.h: what is mapped, what will be; each page once it is used, or all that is reserved for
# stacks and libraries would be taken: some 400 MB more.
_LOCK_ALL = 1 | 2 | 4  # MCL_CURRENT, MCL_FUTURE, MCL_ONFAULT


class Scheduling:
    """How the thread that calls `begin` is scheduled: SCHED_FIFO by `priority`; 0: as any other."""

    def __init__(self, priority: int) -> None:
        self._priority = priority
        self._granted = self._ahead = False
        self._look_ns = self._looked_ns = self._spent_ns = 0

    def begin(self) -> None:
        """From now on, in the calling thread, if that is allowed."""
        if self._priority:
            try:
                self._run_ahead(True)
                self._granted = True
            except PermissionError:
                pass  # `refusal` says it

    @property
    def refusal(self) -> str:
        """Why it could not be had; empty: nothing was refused."""
        if self._granted or not self._priority:
            return ""
        allowed = resource.getrlimit(resource.RLIMIT_RTPRIO)[0]
        if 0 <= allowed < self._priority:
            return f"SCHED_FIFO is allowed up to priority {allowed}, not {self._priority}"
        return "SCHED_FIFO is refused: this control group has no time for it (cpu.rt_runtime_us)"

    def look(self) -> None:
        """In every round of the thread: whether it leaves the others time."""
        if not self._granted or (now_ns := time.monotonic_ns()) < self._look_ns:
            return
        spent_ns = time.thread_time_ns()
        waits = spent_ns - self._spent_ns < SHARE * (now_ns - self._looked_ns)
        if waits != self._ahead:
            self._run_ahead(waits)
        self._looked_ns, self._spent_ns = now_ns, spent_ns
        self._look_ns = now_ns + WINDOW_NS

    def _run_ahead(self, ahead: bool) -> None:
        policy = os.SCHED_FIFO if ahead else os.SCHED_OTHER
        priority = os.sched_param(self._priority if ahead else 0)
        os.sched_setscheduler(0, policy | os.SCHED_RESET_ON_FORK, priority)
        self._ahead = ahead

    def __str__(self) -> str:
        return f"SCHED_FIFO {self._priority}" if self._granted else "SCHED_OTHER"


def lock_memory() -> str:
    """What the process uses of memory stays in it; why it may not.

    Not up to a limit: what then comes beyond it would not be had at all, a thread's stack for one.
    """
    limit = resource.getrlimit(resource.RLIMIT_MEMLOCK)[0]
    if limit != resource.RLIM_INFINITY and not _has(_CAP_IPC_LOCK):
        return f"memory may be locked up to {limit // 1024} kB, not unlimited"
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.mlockall(_LOCK_ALL):
        return f"memory can't be locked: {os.strerror(ctypes.get_errno())}"
    return ""


def _has(capability: int) -> bool:
    """Whether the process has it (proc_pid_status(5), CapEff)."""
    lines = Path("/proc/self/status").read_text().splitlines()
    (held,) = (int(line.split()[1], 16) for line in lines if line.startswith("CapEff:"))
    return bool(held >> capability & 1)
