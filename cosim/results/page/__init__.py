"""Pages about runs: one self-contained HTML file each, for any system."""
