"""The robot in motion, for pages of any run that has it."""
