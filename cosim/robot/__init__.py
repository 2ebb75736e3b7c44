"""Everything in `cosim` that knows the robot: trajectory, scenarios, metrics, figures."""
