"""The commands of the `cosim` program, one module each."""
