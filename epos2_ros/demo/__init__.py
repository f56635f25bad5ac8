"""`epos2_ros demo`: the driver and simulated drives run a trajectory, with a report.

A witness of its own: it talks to the driver over ROS alone, takes what the drives really did
from the simulation's log, and evaluates the commanded curve itself.
"""

from epos2_ros.demo.program import main

__all__ = ["main"]
