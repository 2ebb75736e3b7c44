"""The adaptive robust controller as a `Model`, and the offline tool that finds its optimal gains."""
