"""Tests of fmu_export.package."""
