"""The tracker service: physics characters that follow planned motion."""
