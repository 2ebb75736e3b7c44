"""Tests of fmu_export.scaffolding."""
