"""What is whole on disk or not there, whenever the process is killed or the power fails."""
