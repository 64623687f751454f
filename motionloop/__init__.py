"""motionloop: text- and target-driven physical characters."""
