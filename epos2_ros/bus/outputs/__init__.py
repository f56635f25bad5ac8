"""Position-triggered outputs at work on a bus."""
