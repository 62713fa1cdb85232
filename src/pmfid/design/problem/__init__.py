"""What is to be designed, and what an input tells of it."""
