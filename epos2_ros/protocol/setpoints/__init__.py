"""Axes that follow a path by set-points, one active in the drive and one queued behind it."""
