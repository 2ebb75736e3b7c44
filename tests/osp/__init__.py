"""Tests of configurations of the Open Simulation Platform."""
