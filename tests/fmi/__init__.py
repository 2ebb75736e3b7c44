"""Tests of fmi."""
