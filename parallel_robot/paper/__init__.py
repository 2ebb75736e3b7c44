"""The paper reproduced: figures, claims, errata, readings, robustness, and the report."""
