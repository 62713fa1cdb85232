"""The figures and claims of the paper: `python -m studies.paper`."""
