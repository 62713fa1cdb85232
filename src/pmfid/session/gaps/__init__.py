"""Missing samples of a drive's record: their places in time, and the values that replace them."""
