"""The process around the characters: sockets, hosting, clock, video."""
