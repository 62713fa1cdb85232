"""The page: overview of all axes, one axis live, alarms; and what guards it."""
