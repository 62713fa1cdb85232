"""Study of the monitor: false alarms, detection, recovery, standstill, delay in a pipe."""
