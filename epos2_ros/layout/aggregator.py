"""Parameters of diagnostic_aggregator, whose node is called `analyzers`: one item for each axis.

An axis that is expected and missing is an error there, not only an axis that says it is one.
"""

from __future__ import annotations

from typing import Any

import yaml

from epos2_ros.configuration.driver import DriverConfig
from epos2_ros.configuration.names import Names

NODE = "analyzers"


def parameters(config: DriverConfig, names: Names) -> dict[str, Any]:
    """Of the node; nested, as in a parameter file."""
    prefix = names.status("")
    # The aggregator writes a blank for each slash in a name before it removes the prefix.
    prefixes = list(dict.fromkeys([prefix, prefix.replace("/", " ")]))
    analyzers = {"axes": [axis.joint for axis in config.axes], "bus": ["bus"]}
    if config.outputs:
        analyzers["outputs"] = [f"compare.{output.name}" for output in config.outputs]
    return {
        "path": names.node.lstrip("/"),
        "pub_rate": 1.0,
        **{
            group: {
                "type": "diagnostic_aggregator/GenericAnalyzer",
                "path": group,
                "expected": [names.status(part) for part in parts],
                "remove_prefix": [*prefixes],  # its own: rcl reads no YAML aliases
            }
            for group, parts in analyzers.items()
        },
    }


def file(config: DriverConfig, names: Names) -> str:
    """The parameter file, YAML."""
    given = {NODE: {"ros__parameters": parameters(config, names)}}
    return str(yaml.safe_dump(given, sort_keys=False, allow_unicode=True))
