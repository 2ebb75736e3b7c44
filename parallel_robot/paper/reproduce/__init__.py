"""The paper's figures, table, claims and errata, computed from runs of the FMUs."""
