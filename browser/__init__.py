"""The page for browsers: its build, and the parts that run in it."""
