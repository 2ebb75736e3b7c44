"""Symbols that act as numpy's arrays do, for functions that are traced."""
