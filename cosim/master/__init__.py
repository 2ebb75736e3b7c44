"""The co-simulation master: from a system and an algorithm to a run of the compiled loop."""
