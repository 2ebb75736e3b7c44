"""Tests of fmu_export.trace."""
