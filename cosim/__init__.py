"""Fixed-step co-simulation of FMUs."""
