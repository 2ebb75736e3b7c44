"""The FMUs in tools that are not ours: the same system, compared with our own runs to a tolerance that is stated.

`python -m interop` runs the matrix; docs/interop.md is what it wrote.
"""
