"""Files: what kind one is, whole or not there, locked, temporary."""
