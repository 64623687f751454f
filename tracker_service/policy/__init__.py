"""Trackers: what turns state and reference into servo targets (numpy only)."""
