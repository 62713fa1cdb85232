"""What to think of estimates: validity, and later the detection of changes."""
