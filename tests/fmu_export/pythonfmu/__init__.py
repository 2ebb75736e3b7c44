"""Tests of fmu_export.pythonfmu."""
