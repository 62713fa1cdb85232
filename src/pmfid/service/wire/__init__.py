"""How blocks and lines are written in messages and on pipes."""
