"""Scenes as YAML data: bodies, poses, masses and marks."""
