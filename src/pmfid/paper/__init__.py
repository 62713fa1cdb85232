"""The figures of the paper as pictures, data and numbers: `pmfid reproduce`."""
