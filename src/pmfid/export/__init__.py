"""The estimator as C for a drive, with the unchanged sources of the kernel and the code of one configuration."""
