"""The bound of waiting for events that must come.

Only a failing test waits that long. A shorter bound would measure the speed of the machine, which may be busy with
other work.
"""

#: Longest time [s] to wait for an event, for the end of a process, or for the answer of a server.
PATIENCE = 900.0
