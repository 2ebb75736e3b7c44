"""Tests of parallel_robot.live."""
