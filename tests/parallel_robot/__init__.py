"""Tests of parallel_robot."""
