"""What a program finds around it: where logs and compiled code can be kept.

A service user, a container or somebody else's installation may have none of the folders in which
ROS and Numba keep things. The programs run there all the same, and say what that costs.
"""

from __future__ import annotations

import os
from pathlib import Path

from epos2_ros.motion import knots


def log_folder() -> Path:
    """Where rcl writes its log files (`rcl_logging_get_logging_directory`)."""
    if folder := os.environ.get("ROS_LOG_DIR"):
        return Path(folder).expanduser()
    return Path(os.environ.get("ROS_HOME") or "~/.ros").expanduser() / "log"


def can_write(folder: Path) -> bool:
    """Whether the folder is there, or can be made, and takes files."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return False
    return os.access(folder, os.W_OK)


def without_log_file() -> tuple[list[str], str]:
    """ROS arguments where rcl's log folder can't be written, and the line that says so.

    rcl would not start otherwise. The console and /rosout have the log in any case.
    """
    folder = log_folder()
    if can_write(folder):
        return [], ""
    line = f"no log file: {folder} can't be written; set ROS_LOG_DIR to a folder that can"
    return ["--ros-args", "--disable-external-lib-logs"], line


def compiling() -> tuple[bool, str]:
    """Whether fitting will take longer than it has to at every start, and a line about it.

    An empty line: nothing has to be compiled (any more). To be said right before something is.
    """
    if knots.prepared():
        return False, ""
    if not knots.COMPILED:
        return True, (
            "Numba is not installed: fitting takes some hundred times longer (Debian, Ubuntu: "
            "sudo apt install python3-numba)"
        )
    if knots.kept_in() is None:
        return True, (
            "compiling the fitter, some 15 s at every start: neither the package's folder nor "
            "~/.cache can be written; set NUMBA_CACHE_DIR to a folder that can"
        )
    if not knots.compiled_before():
        return False, "compiling the fitter, once after an installation: some 15 s"
    return False, ""
