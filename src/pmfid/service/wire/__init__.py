"""The form of blocks and lines in messages and on pipes."""
