"""The program `monitor`: a live table of all axes and the bus, in a terminal (docs/pictures.md).

`seen` keeps what the driver's topics say, `view` draws it with Rich, `keyboard` reads keys,
`program` is the ROS node and the command line.
"""

from epos2_ros.monitor.program import main

__all__ = ["main"]
