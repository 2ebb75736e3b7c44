"""What is simulated: components, connections and signals, and their checks against the model descriptions."""
