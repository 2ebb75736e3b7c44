"""What other people's files can do to a master: broken and hostile ones, kills, full disks."""
