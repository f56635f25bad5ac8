"""The stored parameters of a drive as a file: YAML with names and units, to be read and edited."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from epos2_ros.commission.parameter_access import Values, written
from epos2_ros.commission.stored import INTEGERS, Parameter, Value, parameters_of
from epos2_ros.errors import ConfigurationError
from epos2_ros.protocol.identity import Identity

COLUMN = 40

HEAD = """\
# Stored parameters of a drive, as `epos2_ros drive dump` read them. `epos2_ros drive restore` sets
# another drive of this kind to the values; names and units are for people.
"""


@dataclass(frozen=True)
class DriveFile:
    """What is in such a file."""

    identity: Identity
    node_id: int
    values: Values

    @property
    def parameters(self) -> Mapping[str, Parameter]:
        return parameters_of(self.identity.vendor_id)


def to_yaml(file: DriveFile) -> str:
    """One line for every parameter."""
    its = file.identity
    lines = [
        "drive:",
        f"  maker: {its.maker}",
        f"  product: {its.product}",
        f"  firmware: {its.firmware}",
        f"  serial_number: {its.serial_number}",
        f"  node_id: {file.node_id}",
        f"  vendor_id: 0x{its.vendor_id:08X}",
        f"  product_code: 0x{its.product_code:08X}",
        f"  revision: 0x{its.revision:08X}",
        "parameters:",
    ]
    for address, value in file.values.items():
        parameter = file.parameters[address]
        text = written(parameter, value)
        start = f"  {address}: {{value: {text if _plain(parameter, value) else _quoted(text)},"
        unit = f" unit: {_quoted(parameter.unit)}," if parameter.unit else ""
        lines.append(f"{start.ljust(COLUMN)}{unit} name: {_quoted(parameter.name)}}}")
    return HEAD + "\n".join(lines) + "\n"


def _plain(parameter: Parameter, value: Value) -> bool:
    return parameter.type in INTEGERS or isinstance(value, int)


def _quoted(text: str) -> str:
    return str(yaml.safe_dump(text, default_style='"', allow_unicode=True, width=1 << 20)).strip()


def read_drive_file(path: Path) -> DriveFile:
    """ConfigurationError in one line for what is no such file, or names what is not known."""
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigurationError(f"can't read {path}: {error.strerror}") from error
    except (ValueError, yaml.YAMLError) as error:
        raise ConfigurationError(f"can't read {path}: {' '.join(str(error).split())}") from error
    drive = content.get("drive") if isinstance(content, Mapping) else None
    entries = content.get("parameters") if isinstance(content, Mapping) else None
    if not isinstance(drive, Mapping) or not isinstance(entries, Mapping):
        raise ConfigurationError(
            f"{path} is no file of `drive dump`: it needs `drive` and `parameters`"
        )
    numbers = ("vendor_id", "product_code", "revision", "serial_number", "node_id")
    for name in numbers:
        if type(drive.get(name)) is not int:
            raise ConfigurationError(f"{path}: drive.{name} must be a whole number")
    vendor, product, revision, serial, node_id = (int(drive[name]) for name in numbers)
    identity = Identity(vendor, product, revision, serial)
    known = parameters_of(vendor)
    values = {
        address: _value(path, address, entry, known, node_id) for address, entry in entries.items()
    }
    return DriveFile(identity, node_id, values)


def _value(
    path: Path, address: Any, entry: Any, known: Mapping[str, Parameter], node_id: int
) -> Value:
    if address not in known:
        raise ConfigurationError(f"{path}: {address} is no stored parameter of this drive")
    value = entry.get("value") if isinstance(entry, Mapping) else entry
    if not isinstance(value, (int, str)):
        raise ConfigurationError(f"{path}: {address} has no value")
    try:
        known[address].encode(value, node_id)
    except ConfigurationError as error:
        raise ConfigurationError(f"{path}: {error}") from error
    return value
