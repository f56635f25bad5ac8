"""Trouble while the axes are being stopped or switched off already: that goes on, and is told."""

from __future__ import annotations

import pytest
from simulated_time import Bench
from six_axes import all_stand, bench, there_and_back

from epos2_ros.configuration.driver import AxisConfig, DriverConfig
from epos2_ros.errors import DriveError
from epos2_ros.protocol.phase import Phase
from epos2_ros.sim.epos2 import Dictionary, Epos2


def faults(made: Bench) -> list[str]:
    return [event.text for event in made.events if event.kind == "fault"]


@pytest.mark.parametrize("what", ["quick_stop", "disable"])
@pytest.mark.parametrize("trouble", ["emergency", "silence", "said"])
def test_trouble_does_not_cut_a_stop_short(what: str, trouble: str) -> None:
    made = bench()
    if what == "quick_stop":
        made.path.submit(there_and_back(2.0, 2.5), None, made.now_us)
        made.run(0.6)
    answer = getattr(made.group, what)()
    made.run(0.001)
    drive = made.drives[2]
    if trouble == "emergency":
        drive.fail(0x7320, made.now_us)
    elif trouble == "silence":
        drive.disconnect()
    else:
        made.group.fail("somebody says so")
    made.run(6.0, answer.done)
    assert answer.done()
    others = [other for other in made.drives if other is not drive]
    assert all(other.state.name != "OPERATION_ENABLED" for other in others)
    assert all_stand(made)
    if trouble == "silence":
        if answer.exception() is None:  # it was quicker than silence is noticed
            made.run(0.6)
        else:
            with pytest.raises(DriveError, match="joint_3 .node 3. is silent"):
                answer.result()
    else:
        assert answer.exception() is None
    made.run(0.5)
    assert made.group.phase is Phase.FAULT
    assert len(faults(made)) == len(set(faults(made))) <= 2
    drive.reconnect()


def test_a_late_host_misses_no_sync_of_a_drive() -> None:
    """What a stalled host has not listened to is not held against the drive that sends SYNC."""
    axes = tuple(AxisConfig(f"joint_{n}", n, gear_ratio=100.0) for n in (1, 2))
    drives = [Epos2(n, dictionary=Dictionary.NOTE) for n in (1, 2)]
    made = Bench(DriverConfig(axes=axes, sync_producer="joint_2"), drives)
    made.enable()
    made.run(0.5)
    unheard = []
    made.bus.run_until(made.now_us + 1.5e6, lambda *frame: unheard.append(frame))
    made._step()
    for frame in unheard:
        made._on_frame(*frame)
    assert all("no SYNC" not in text for text in faults(made))
    answer = made.group.reset_fault()  # the drives have missed the host
    made.wait(answer)
    made.enable()
    made.bus.drop = lambda can_id, data, source: can_id == 0x080
    made.run(2.0)
    assert any("no SYNC from joint_2" in text for text in faults(made))
