"""The program `replay`: what happened on a bus, from its log alone (docs/replay.md).

`reader` gives the lines of a log, `sdo` and `decode` make of bytes what was meant, `words` says
it, `timeline` tells what changed, `rerun` runs the protocol layer over it again, `history` keeps
what `plot` draws.
"""

from epos2_ros.replay.program import main

__all__ = ["main"]
