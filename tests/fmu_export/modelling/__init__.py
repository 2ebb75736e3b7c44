"""Tests of fmu_export.modelling."""
