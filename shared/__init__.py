"""Motion, protocol, plug-in interfaces and data handling used by every motionloop service."""
