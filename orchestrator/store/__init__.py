"""What survives a restart: the SQLite database and the recordings."""
