"""Simulated EPOS2 drives: a CANopen slave of their own, stepping on an explicit clock.

Beside the driver, not part of it: nothing here is shared with `protocol/` or `bus/`,
so a misreading of a document can't hide in both ends.
"""
