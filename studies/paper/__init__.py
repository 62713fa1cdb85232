"""The figures of the paper as pictures, data and numbers: `python -m studies.paper`."""
