"""Structures and saved states of the C kernel, as Python reads them."""
