"""Messages, their wire form and the ZeroMQ transport."""
