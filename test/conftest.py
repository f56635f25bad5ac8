"""What the tests share: a clean ROS environment, the examples, virtual CAN interfaces."""

from __future__ import annotations

import fcntl
import os
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib.util import find_spec
from pathlib import Path

import pytest
from socketcan_guest import Guest, Recorder, kernel_has_vcan, run_tool

ROOT = Path(__file__).resolve().parent.parent


# Their tests run in real time: what else the machine does at the same time would be measured.
REALTIME = {
    "action", "adapters", "check", "demo", "docs", "driver", "driver_outputs", "host_fails",
    "moveit_example", "node", "node_outputs", "packaging", "scan", "sim_realtime", "socketcan",
    "socketcan_driver", "supervisor", "surroundings", "timestamps", "udp_multicast",
}  # fmt: skip


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if item.path.stem.removeprefix("test_") in REALTIME:
            item.add_marker(pytest.mark.realtime)


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--require-socketcan",
        action="store_true",
        help="let tests marked socketcan fail, not be skipped, where they can't run",
    )
    parser.addoption(
        "--require-control-msgs",
        action="store_true",
        help="refuse to run without control_msgs, which the tests of the action need",
    )
    parser.addoption(
        "--fuzz", type=int, default=1, metavar="N", help="N times as many random cases"
    )
    parser.addoption("--record-reports", type=Path, help="(for the guest) write each report here")


def pytest_configure(config: pytest.Config) -> None:
    if config.getoption("--require-control-msgs") and find_spec("control_msgs") is None:
        raise pytest.UsageError("control_msgs is not installed: see test/interfaces/build")
    record = config.getoption("--record-reports")
    if record:
        config.pluginmanager.register(Recorder(config, record))
    elif not kernel_has_vcan():
        required = config.getoption("--require-socketcan")
        config.pluginmanager.register(Guest(config, required))


@pytest.fixture(scope="session")
def fuzz(request: pytest.FixtureRequest) -> int:
    """How many times as many random cases as usual are to be tried."""
    return int(request.config.getoption("--fuzz"))


@pytest.fixture(scope="session")
def examples() -> Path:
    """The folder of the example trajectories."""
    return ROOT / "examples"


@contextmanager
def free_domain() -> Iterator[int]:
    """A ROS domain that no other test on this machine uses at the same time."""
    for domain in range(1, 101):  # up to 101 the ports stay below Linux' ephemeral ones
        with _lock_file(f"epos2_ros_test_domain_{domain}").open() as lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                continue
            yield domain
            return
    pytest.fail("all ROS domains from 1 to 100 are in use by other tests")


def _lock_file(name: str) -> Path:
    """One for all users of this machine, any of whom may have made it; reading is enough."""
    path = Path(tempfile.gettempdir()) / name
    with suppress(FileExistsError):
        os.close(os.open(path, os.O_CREAT | os.O_EXCL, 0o644))
    return path


@pytest.fixture(autouse=True, scope="session")
def ros_log_folder(tmp_path_factory: pytest.TempPathFactory) -> None:
    """ROS writes no log into the home of whoever runs the tests, and needs none."""
    os.environ.setdefault("ROS_LOG_DIR", str(tmp_path_factory.mktemp("ros_log")))


@pytest.fixture
def ros_domain_id() -> Iterator[int]:
    """A ROS domain of this test's own."""
    with free_domain() as domain:
        yield domain


@pytest.fixture(scope="module")
def module_domain_id() -> Iterator[int]:
    """A ROS domain of this module's own."""
    with free_domain() as domain:
        yield domain


@pytest.fixture
def ros_env(ros_domain_id: int) -> dict[str, str]:
    """Environment for a process of its own that uses ROS and the package under test.

    The wheels' interpreter was re-executed with `LD_LIBRARY_PATH` and a mark that this is done;
    a child of another prefix has to do that for itself.
    """
    env = {name: value for name, value in os.environ.items() if not name.startswith("PYTEST_")}
    if env.pop("_ROS_WHEELS_BOOTSTRAP_COMPLETE", None):
        env.pop("LD_LIBRARY_PATH", None)
    prefixes = [sys.prefix, *filter(None, [env.get("AMENT_PREFIX_PATH")])]
    return env | {
        "AMENT_PREFIX_PATH": os.pathsep.join(prefixes),
        "PYTHONPATH": os.pathsep.join([str(ROOT), *filter(None, [env.get("PYTHONPATH")])]),
        "PYTHONUNBUFFERED": "1",
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "ROS_DOMAIN_ID": str(ros_domain_id),
    }


@pytest.fixture
def vcan() -> Iterator[str]:
    """The name of a virtual CAN interface of this test's own (mark: socketcan)."""
    name = f"vcan{os.getpid() % 10**6}"
    run_tool("ip", "link", "add", name, "type", "vcan")
    try:
        run_tool("ip", "link", "set", name, "up")
        yield name
    finally:
        run_tool("ip", "link", "delete", name)


@pytest.fixture
def slow_vcan(vcan: str) -> str:
    """`vcan` with a real adapter's transmit queue: ten frames, one sent each millisecond.

    To the kernel a frame has 16 bytes: `limit` is ten of them, `rate` one in 1.024 ms. A frame
    that finds the queue full is refused with ENOBUFS.
    """
    shape = ["rate", "125kbit", "burst", "16", "limit", "160"]
    run_tool("tc", "qdisc", "add", "dev", vcan, "root", "tbf", *shape)
    return vcan
