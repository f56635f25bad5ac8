"""Records in the buffers of EPOS2 drives: which goes when, and whether they are executed."""
