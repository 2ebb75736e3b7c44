"""Export of FMI-free models: one `Model`, many back ends (FMUs, python-control)."""
