"""Scenarios: systems and their runs as TOML files."""
