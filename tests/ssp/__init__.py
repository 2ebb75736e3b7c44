"""Tests of ssp."""
