"""What rcl itself makes of a parameter file: a fixture."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import rclpy
from rclpy.context import Context
from rclpy.node import Node

Rcl = Callable[..., Any]


@pytest.fixture
def rcl(tmp_path: Path) -> Iterator[Rcl]:
    """What a node of this name gets from a file, by rcl; None where rcl refuses the file."""
    file = tmp_path / "parameters.yaml"

    def read(text: str, node: str = "/epos2_driver") -> dict[str, Any] | None:
        file.write_text(text, encoding="utf-8")
        namespace, _, name = node.rpartition("/")
        arguments = ["--ros-args", "--params-file", str(file), "-r", f"__ns:={namespace or '/'}"]
        context = Context()
        try:
            rclpy.init(args=arguments, context=context)
        except Exception:
            return None
        try:
            made = Node(name, context=context)
            overrides = {key: value.value for key, value in made._parameter_overrides.items()}
            made.destroy_node()
        finally:
            context.shutdown()
        return {key: list(v) if hasattr(v, "tolist") else v for key, v in overrides.items()}

    yield read
