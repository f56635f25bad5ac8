"""The program `epos2_ros driver` as a process of its own: a fixture."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Iterator

import pytest

WAIT_S = 20.0  # for something that must happen; reached only when it does not


class Program:
    """`epos2_ros driver` with simulated drives, as a process of its own."""

    def __init__(self, env: dict[str, str], *arguments: str) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-m", "epos2_ros", "driver", *arguments],
            env=env,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        self.output = ""

    def read_until(self, words: str) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            self.output += line
            if words in line:
                return
        pytest.fail(f"no {words!r} in {self.output}")

    def end(self, number: int) -> int:
        """Sends the signal and gives the exit status."""
        self._process.send_signal(number)
        rest, _ = self._process.communicate(timeout=WAIT_S)
        self.output += rest
        return self._process.returncode

    def wait(self) -> int:
        """Its exit status, when it ends by itself."""
        return self._process.wait(WAIT_S)

    def kill(self) -> None:
        self._process.kill()
        self._process.wait()


@pytest.fixture
def program(ros_env: dict[str, str]) -> Iterator[Callable[..., Program]]:
    programs: list[Program] = []

    def start(*arguments: str) -> Program:
        programs.append(Program(ros_env, *arguments))
        return programs[-1]

    yield start
    for it in programs:
        it.kill()
