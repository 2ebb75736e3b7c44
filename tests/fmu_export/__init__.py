"""Tests of fmu_export."""
