"""Tests of cosim.model_page."""
