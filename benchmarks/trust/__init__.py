"""What hostile and broken input, kills and full disks cost: `python -m benchmarks.trust`."""
