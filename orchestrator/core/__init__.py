"""State machine, loop, plan stitching and supervision."""
