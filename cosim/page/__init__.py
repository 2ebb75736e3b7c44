"""Pages of HTML that need no other file: their frame, plots, diagrams and servers; what is shown comes from above."""
