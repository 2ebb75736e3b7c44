"""SSP archives (System Structure and Parameterization 1.0 and 2.0): read them into a `System`, write a `System` as one.

An SSP is a zip archive of FMUs, of `SystemStructure.ssd`, which says how they are connected, and of parameter sets
(SSV) and mappings of their names (SSM).
"""
