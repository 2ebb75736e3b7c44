"""The page of a sweep: a scatter plot and a table of its runs, of those that are done or as they come."""
