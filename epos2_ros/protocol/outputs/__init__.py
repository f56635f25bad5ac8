"""Position-triggered outputs, without I/O: what a drive is told of them, and what has fired."""
