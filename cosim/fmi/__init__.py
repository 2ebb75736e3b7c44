"""FMI: FMU files, instances and types; the only room that calls FMPy."""
