"""The robot: a planar 2-DOF redundantly actuated parallel mechanism as a `Model`."""
