"""Tests of fmu_export.wasm."""
