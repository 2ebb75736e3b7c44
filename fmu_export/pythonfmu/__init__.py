"""The pythonfmu flavour: FMUs that run Python."""
