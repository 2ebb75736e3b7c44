"""Tests of fmu_export.native."""
