"""Videos of the log, made in a process of its own; no simulation."""
