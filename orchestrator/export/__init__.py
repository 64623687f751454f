"""Recordings as files other tools read."""
