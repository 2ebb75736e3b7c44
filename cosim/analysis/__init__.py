"""Analysis of coupled systems: linearisation and stability."""
