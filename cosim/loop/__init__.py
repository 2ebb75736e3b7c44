"""The compiled stepping loop: C, built when the package is installed."""
