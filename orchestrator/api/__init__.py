"""REST, WebSocket and event streams."""
