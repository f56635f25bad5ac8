"""Who a drive is: in words, at the driver's start-up, in its snapshot and in diagnostics."""

from __future__ import annotations

from dataclasses import replace

import pytest
from builtin_interfaces.msg import Time
from simulated_time import axes

from epos2_ros.bus.driver import Driver
from epos2_ros.configuration.driver import ClockLimits, DriverConfig
from epos2_ros.node import messages
from epos2_ros.protocol.identity import Identity
from epos2_ros.protocol.outbox import Event


@pytest.mark.parametrize(
    ("identity", "words"),
    [
        (
            Identity(0xFB, 0x6420_0000, 0x2126_0000, 17, "EPOS2"),
            "maxon EPOS2 70/10, firmware 2126h, serial number 17",
        ),
        (
            Identity(0xFB, 0x6322_0000, 0x2120_0000, 17),
            "maxon EPOS2 50/5, firmware 2120h, serial number 17",
        ),
        (
            Identity(0xFB, 0x1234_0000, 0x2101_0000, 1, "EPOS2"),
            "maxon EPOS2 (hardware 1234h), firmware 2101h, serial number 1",
        ),
        (
            Identity(0xAB, 0x380, 0x1_0028, 5, "AEP", "1.40"),
            "Copley AEP, firmware 1.40, serial number 5",
        ),
        (
            Identity(0x26C, 3, 0, 9),
            "Nanotec product 0x00000003, firmware revision 0x00000000, serial number 9",
        ),
        (
            Identity(0x999, 0, 0, 0),
            "vendor 0x00000999 product 0x00000000, firmware revision 0x00000000, serial number 0",
        ),
    ],
)
def test_identity_in_words(identity: Identity, words: str) -> None:
    assert str(identity) == words


def test_start_up_names_every_drive_once() -> None:
    first, second, third = axes(3)
    config = DriverConfig(
        axes=(first, replace(second, drive="copley"), third), channel="who is who"
    )
    events: list[Event] = []
    driver = Driver(config, on_event=events.append)
    try:
        driver.configure()
        driver.reset_fault()
        snapshot = driver.snapshot()
    finally:
        driver.close()  # by then all events have been told
    named = [event.text for event in events if event.kind == "drive"]
    assert [text.partition(":")[0] for text in named] == [
        "joint_1 (node 1)", "joint_2 (node 2)", "joint_3 (node 3)",
    ]  # fmt: skip
    assert all("firmware" in text and "serial number" in text for text in named)
    assert "Copley AEP, firmware 1.40, serial number 2" in named[1]
    keys = [
        {pair.key: pair.value for pair in status.values}
        for status in messages.diagnostics(
            snapshot, "node", "can0", Time(), ClockLimits()
        ).status[:3]
    ]
    for axis, values in zip(snapshot.axes, keys, strict=True):
        assert axis.identity is not None
        assert values["serial number"] == str(axis.identity.serial_number)
        assert values["firmware"] == axis.identity.firmware
    assert keys[1]["product"] == "Copley AEP"
    assert keys[0]["product"].startswith("maxon EPOS2")
