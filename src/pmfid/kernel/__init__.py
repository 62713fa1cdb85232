"""The memory of the kernel as Python sees it: its structures, and saved states."""
