"""The page with an overview of all axes, one live axis and alarms, and the protection of the page."""
