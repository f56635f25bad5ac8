"""The program `plan`: what the driver would make of a trajectory, without a bus and without ROS.

`planning` computes it, with the driver's own group, feeder and fitter; `report` says it in words
and as CSV, `plot` draws it, `program` is the command line.
"""

from epos2_ros.plan.program import main

__all__ = ["main"]
