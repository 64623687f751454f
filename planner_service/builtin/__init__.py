"""Planners that need no training: `stand` and `clip`."""
