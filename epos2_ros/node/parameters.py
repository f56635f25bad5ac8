"""The node's parameters: those of `configuration/parameters` as ROS declares and changes them.

A wrong or unknown parameter does not keep the node from coming up: the default stands in, and
the lifecycle transition "configure" fails with its line until the value has been put right with
`ros2 param set` or in the file.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.node import Node
from rclpy.parameter import Parameter

from epos2_ros.configuration.driver import DriverConfig
from epos2_ros.configuration.outputs import CompareConfig
from epos2_ros.configuration.parameters import DriverParameters, Spec
from epos2_ros.errors import Epos2RosError


class Parameters:
    """Declares the node's parameters and reads them as a `DriverConfig`.

    `changeable` tells whether a new value may be taken now (the node is unconfigured). What
    belongs to an output may change later, too: `set_output` lets its drive follow, or raises.
    """

    def __init__(
        self,
        node: Node,
        changeable: Callable[[], bool],
        set_output: Callable[[CompareConfig], None] = lambda config: None,
    ) -> None:
        self._changeable = changeable
        self._set_output = set_output
        # What files and command line say, whether declared or not; rclpy has no public name for
        # it.
        overrides = node._parameter_overrides.items()
        self._parameters = DriverParameters({name: p.value for name, p in overrides})
        for name, spec in self._parameters.specs.items():
            value, described = self._parameters.values[name], descriptor(spec)
            if _of_output(name):
                described.additional_constraints = f"{spec.allowed}; changes while the axes stand"
            _declare(node, name, value, described)
        self._node = node
        self._noted: Parameter | None = None
        node.add_on_set_parameters_callback(self._review)
        node.add_post_set_parameters_callback(self._take)

    def __getitem__(self, name: str) -> Any:
        return self._parameters.values[name]

    @property
    def outputs(self) -> list[str]:
        """Names of the position-triggered outputs."""
        return list(self["outputs"])

    def config(self) -> DriverConfig:
        """The parameters as they stand; ConfigurationError for the first that is wrong."""
        return self._parameters.config()

    def note_positions(self, output: str, positions: Sequence[float]) -> None:
        """A series has other positions, which its drive has already: the parameter says so."""
        name = f"compare.{output}.positions"
        self._noted = Parameter(name, Parameter.Type.DOUBLE_ARRAY, list(positions))
        self._node.set_parameters([self._noted])

    def _review(self, changes: Iterable[Parameter]) -> SetParametersResult:
        """Refuses at `ros2 param set` what would make `config` fail, and changes too late."""
        changes = list(changes)
        if any(change is self._noted for change in changes):
            return SetParametersResult(successful=True)
        for change in changes:
            spec = self._parameters.specs.get(change.name)
            if spec is None:  # rclpy's own, such as use_sim_time
                continue
            if not self._changeable() and not _of_output(change.name):
                reason = f"{change.name} can change only while the node is unconfigured"
                return SetParametersResult(successful=False, reason=reason)
            try:
                spec.read(change.value)
            except ValueError:
                reason = spec.complaint(change.name, change.value)
                return SetParametersResult(successful=False, reason=reason)
        if not self._changeable():
            try:
                self._change_outputs(changes)
            except Epos2RosError as error:
                return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _change_outputs(self, changes: Iterable[Parameter]) -> None:
        """All changes of an output at once: between them it need make no sense."""
        changes = [change for change in changes if change.name in self._parameters.specs]
        changed = [
            output
            for output in self.outputs
            if any(change.name.startswith(f"compare.{output}.") for change in changes)
        ]
        values = dict(self._parameters.values)
        before = [self._parameters.output(output) for output in changed]
        followed: list[CompareConfig] = []
        try:
            for change in changes:
                self._parameters.set(change.name, change.value)
            for output, config in zip(changed, before, strict=True):
                self._set_output(self._parameters.output(output))
                followed.append(config)
        except Epos2RosError:
            self._parameters.values.update(values)
            for config in followed:
                self._set_output(config)
            raise

    def _take(self, changes: Iterable[Parameter]) -> None:
        for change in changes:
            if change.name in self._parameters.specs:
                self._parameters.set(change.name, change.value)


def _declare(node: Node, name: str, value: Any, described: ParameterDescriptor) -> None:
    if value != []:
        node.declare_parameter(name, value, described, ignore_override=True)
        return
    # rclpy takes an empty list for one of bytes, unless it is set to a type declared before.
    of = Parameter.Type.DOUBLE_ARRAY if _of_output(name) else Parameter.Type.STRING_ARRAY
    node.declare_parameter(name, of, ignore_override=True)
    node.set_parameters([Parameter(name, of, value)])
    described.name, described.type = name, of.value
    node.set_descriptor(name, described)


def _of_output(name: str) -> bool:
    return name.startswith("compare.")


def descriptor(spec: Spec) -> ParameterDescriptor:
    """As ROS declares it; what a range cannot say stands in `additional_constraints`."""
    fixed = "fixed at start" if spec.read_only else "changes only while unconfigured"
    result = ParameterDescriptor(
        description=spec.meaning,
        additional_constraints=f"{spec.allowed}; {fixed}",
        read_only=spec.read_only,
    )
    # Tools make sliders of ranges: rqt_reconfigure stops at an infinite end, or one beyond 32 bits.
    if isinstance(spec.default, float) and math.isfinite(spec.low) and math.isfinite(spec.high):
        result.floating_point_range = [FloatingPointRange(from_value=spec.low, to_value=spec.high)]
    elif type(spec.default) is int and not spec.choices and spec.high < 2**31:
        result.integer_range = [IntegerRange(from_value=int(spec.low), to_value=int(spec.high))]
    return result
