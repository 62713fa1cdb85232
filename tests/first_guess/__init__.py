"""Logs of simulated axes in the shapes in which oscilloscopes, serial monitors, controllers and MATLAB write them."""
