"""What is in an FMU besides its code: descriptions, documentation, start values, the archive."""
