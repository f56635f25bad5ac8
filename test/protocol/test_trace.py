"""What the log's debug level tells: every state walk, all records, every SYNC."""

from __future__ import annotations

import re

from simulated_time import Bench, axes

from epos2_ros.configuration.driver import DriverConfig
from epos2_ros.motion.trajectory import Trajectory
from epos2_ros.protocol import epos2
from epos2_ros.protocol.trace import Trace

WALK = [
    "switch on disabled → ready to switch on (statusword",
    "ready to switch on → switched on (statusword",  # while the power stage measures the motor
    "switched on → operation enabled (statusword",
    "operation enabled → ready to switch on (statusword",
]


def test_a_run_from_off_to_off_is_told_step_by_step() -> None:
    bench = Bench(DriverConfig(axes=axes(2)))
    lines: list[str] = []
    trace = Trace(bench.machine, lines.append)

    def run(seconds: float) -> None:
        bench.run(seconds, lambda: bool(trace.watch()))

    run(0.5)
    answer = bench.group.enable()
    run(1.0)
    answer.result(timeout=0)
    points = [
        {"positions": [0.0, 0.0], "time_from_start": {}},
        {"positions": [0.5, -0.5], "time_from_start": {"sec": 2}},
    ]
    joints = ["joint_1", "joint_2"]
    bench.path.submit(
        Trajectory.from_dict({"joint_names": joints, "points": points}), None, bench.now_us
    )
    run(3.0)
    bench.group.disable()
    run(1.0)

    for axis in bench.machine.drives:
        walked = [line for line in lines if line.startswith(f"{axis}: ")]
        assert len(walked) == len(WALK)
        assert all(step in line for step, line in zip(WALK, walked, strict=True))
    phases = [line.partition(" → ")[2] for line in lines if line.startswith("group: ")]
    assert phases[0] == "enabling" and phases[-1] == "disabled"
    assert phases.index("standing") < phases.index("moving")
    told = dict.fromkeys(joints, 0)
    for line in lines:
        if line.startswith("records sent: "):
            for joint, count in re.findall(r"(joint_\d) (\d+) ", line):
                told[joint] += int(count)
    sent = {
        f"joint_{n}": sum(f.can_id == epos2.RPDO1 + n for _, f, _ in bench.frames) for n in (1, 2)
    }
    assert told == sent and min(told.values()) > 3
    syncs = [line for line in lines if line.startswith("SYNC ")]
    assert len(syncs) == sum(f.can_id == 0x080 for _, f, _ in bench.frames)
    assert re.fullmatch(
        r"SYNC \d+: clocks were off by \[us\] joint_1 [+-][\d.]+, joint_2 [+-][\d.]+", syncs[-1]
    )
