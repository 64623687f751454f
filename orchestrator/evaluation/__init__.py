"""Measuring tasks, text commands and speed over the real services."""
