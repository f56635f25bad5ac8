"""Reading who a drive is, by SDO, from any CANopen device: no EDS is needed."""

from __future__ import annotations

import canopen

from epos2_ros.errors import DriveError
from epos2_ros.protocol.identity import Identity

DEVICE_NAME, SOFTWARE_VERSION, IDENTITY = 0x1008, 0x100A, 0x1018


def read_identity(node: canopen.RemoteNode) -> Identity:
    """Objects 0x1008, 0x100A and 0x1018; what the device does not have is 0 or "".

    DriveError when it does not answer.
    """
    numbers = (_upload(node, IDENTITY, subindex) for subindex in range(1, 5))
    vendor, product, revision, serial = (int.from_bytes(data, "little") for data in numbers)
    texts = (_upload(node, index, 0) for index in (DEVICE_NAME, SOFTWARE_VERSION))
    name, software = (data.rstrip(b"\0").decode("latin-1").strip() for data in texts)
    return Identity(vendor, product, revision, serial, name, software)


def _upload(node: canopen.RemoteNode, index: int, subindex: int) -> bytes:
    """What the object holds, nothing where the device refuses."""
    try:
        return bytes(node.sdo.upload(index, subindex))
    except canopen.SdoAbortedError:
        return b""
    except canopen.SdoCommunicationError as error:
        raise DriveError(f"node {node.id} does not tell who it is: {error}") from error
