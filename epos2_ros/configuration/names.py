"""What a driver's topics, statuses and bus are called, from the node's full name; without ROS."""

from __future__ import annotations

from dataclasses import dataclass

from epos2_ros.configuration.files import DRIVER


@dataclass(frozen=True)
class Names:
    """Of the node with this full name: `/epos2_driver`, `/robot1/epos2_driver`."""

    node: str = f"/{DRIVER}"

    def topic(self, name: str) -> str:
        """Full name of `~/private`, `relative` or `/absolute`, without remapping."""
        if name.startswith("~/"):
            return f"{self.node}{name[1:]}"
        return name if name.startswith("/") else f"{self.namespace}/{name}"

    def status(self, part: str) -> str:
        """`name` of the status of a joint, of `compare.<output>` or of `bus` in `/diagnostics`."""
        return f"{self.node.lstrip('/')}: {part}"

    def bus(self, channel: str) -> str:
        """`hardware_id` of the bus; that of a drive is this, a slash and the node id."""
        namespace = self.namespace.lstrip("/")
        return f"{namespace}/{channel.lstrip('/')}" if namespace else channel

    @property
    def logger(self) -> str:
        """Name of its lines in `/rosout`."""
        return self.node.strip("/").replace("/", ".")

    @property
    def namespace(self) -> str:
        """`/robot1`, or "" at the root."""
        return self.node.rpartition("/")[0]
