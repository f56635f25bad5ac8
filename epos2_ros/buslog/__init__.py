"""The log of a bus: every frame both ways, and what the driver was asked and said meanwhile.

Beside the layers: `asc` is the file's lines, `writer` a thread that writes them, `inputs` what of
the protocol layer has to be in it so that the same code can be run over it again, `plain` the
configuration as JSON has it.
"""
