"""Results of runs: in memory, on the disk, as files, tables and plots."""
