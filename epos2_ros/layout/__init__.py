"""The program `layout`: settings of other people's tools for one driver's joints and outputs.

`tabs` says what there is to draw; `plotjuggler` and `foxglove` write it as these applications
read it, `aggregator` the parameters of diagnostic_aggregator; `program` is the command line.
Without ROS. See docs/pictures.md.
"""

from epos2_ros.layout.program import main

__all__ = ["main"]
