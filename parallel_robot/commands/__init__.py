"""The robot's commands of the program `cosim`."""
