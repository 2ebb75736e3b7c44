"""The parallel robot of Han et al. 2021 under adaptive robust control: everything that knows this robot."""
