"""The numpy functions of a model traced into expression graphs."""
