"""Tests marked `socketcan`: run here where the kernel has vcan, else in a user-mode Linux.

In the second case one guest (uml/run) runs them all with a pytest of its own, which writes its
reports to a file; they are then given out here as if the tests had run here. Of a module all tests
are marked, or none: pytest sets up and tears down modules only around tests that run here.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import pytest

RUN = Path(__file__).parent / "uml" / "run"
GUEST_TIMEOUT_S = 900


def kernel_has_vcan() -> bool:
    """Whether virtual CAN interfaces can be made here, with echo on transmission (see uml/init)."""
    if os.geteuid() != 0:
        return False
    parameter = Path("/sys/module/vcan/parameters/echo")
    if not parameter.exists():
        try:
            subprocess.run(["modprobe", "--quiet", "vcan", "echo=1"], check=False)
        except FileNotFoundError:
            return False
    return parameter.exists() and parameter.read_text().strip() == "Y"


def run_tool(*command: str) -> None:
    """Run a program by its full path.

    Python holds its lock until the new program runs. To try one folder of PATH after the other
    takes half a second in a guest on a busy computer, and so long no thread of a driver in this
    process sends a heartbeat.
    """
    program = shutil.which(command[0])
    assert program, f"{command[0]} is not installed"
    subprocess.run([program, *command[1:]], check=True)


class Recorder:
    """In the guest: writes every report to a file, a line each."""

    def __init__(self, config: pytest.Config, path: Path) -> None:
        self._config, self._path = config, path

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        data = self._config.hook.pytest_report_to_serializable(config=self._config, report=report)
        with self._path.open("a") as file:
            file.write(json.dumps(data) + "\n")


class Guest:
    """Outside: has the marked tests run in a guest and replays their reports.

    Where no guest can be started they are skipped with the reason, or with `required` fail.
    """

    def __init__(self, config: pytest.Config, required: bool) -> None:
        self._config, self._required = config, required
        self._reports: dict[str, list[pytest.TestReport]] = {}
        self._output = ""

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        """They come last: what others have set up is taken down before one that runs here."""
        items.sort(key=lambda item: item.get_closest_marker("socketcan") is not None)

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtestloop(self, session: pytest.Session) -> None:
        items = [item for item in session.items if item.get_closest_marker("socketcan")]
        if items and not session.config.option.collectonly:
            terminal: Any = self._config.pluginmanager.get_plugin("terminalreporter")
            terminal.write_line(f"{len(items)} SocketCAN tests run under user-mode Linux first")
            self._run([item.nodeid for item in items])

    def pytest_runtest_protocol(self, item: pytest.Item) -> bool | None:
        if not item.get_closest_marker("socketcan"):
            return None
        reports = self._reports.get(item.nodeid, [])
        if not reports or reports[-1].when != "teardown":
            reports.append(self._not_completed(item))
        item.ihook.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)
        for report in reports:
            item.ihook.pytest_runtest_logreport(report=report)
        item.ihook.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)
        return True

    def _run(self, node_ids: list[str]) -> None:
        with tempfile.TemporaryDirectory() as folder:
            record = Path(folder) / "reports"
            pytest_command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider"]
            ended = subprocess.run(
                [str(RUN), *pytest_command, f"--record-reports={record}", *node_ids],
                cwd=self._config.rootpath,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
                timeout=GUEST_TIMEOUT_S,
            )
            self._output = ended.stdout[-4000:].strip()
            for line in record.read_text().splitlines() if record.exists() else []:
                report = self._config.hook.pytest_report_from_serializable(
                    config=self._config, data=json.loads(line)
                )
                if isinstance(report.longrepr, list):  # JSON's word for a skip's tuple
                    report.longrepr = tuple(report.longrepr)
                self._reports.setdefault(report.nodeid, []).append(report)

    def _not_completed(self, item: pytest.Item) -> pytest.TestReport:
        """The report of a test that the guest did not run, or not to its end."""
        where = (str(item.path), item.location[1] or 0)
        skipped = not (self._required or self._reports)
        problem = (
            "the guest's pytest ended before this test did:\n"
            if self._reports
            else "no vcan in this kernel, and no guest with it: "
        ) + self._output
        return pytest.TestReport(
            item.nodeid,
            item.location,
            keywords={},
            outcome="skipped" if skipped else "failed",
            longrepr=(*where, problem) if skipped else problem,
            when="setup",
        )
