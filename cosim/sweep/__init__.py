"""Many runs of a system: a design says which, Dask runs them on this machine or a cluster, Parquet keeps the rows.

Nothing here knows a robot. A `Study` says what a point of the design means.
"""
