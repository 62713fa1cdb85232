"""The estimator as C for a drive: the kernel's sources as they are, and what this configuration adds to them."""
