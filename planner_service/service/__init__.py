"""The planner over ZeroMQ: sockets, batching, checks."""
