"""Interfaces that planners, trackers and tasks implement, the registry and the conformance suite."""
