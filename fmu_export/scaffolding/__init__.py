"""`cosim new`: the first version of a model, a plant or a controller, with a test."""
