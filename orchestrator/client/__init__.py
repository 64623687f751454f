"""Typed, light HTTP client."""
