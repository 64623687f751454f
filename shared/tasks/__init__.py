"""Tasks: what a character should do, how it is told so, and when it has succeeded."""
