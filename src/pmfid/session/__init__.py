"""The session floor: configuration, records and the pipeline that ties the rooms together.

Nothing is imported here, so that a command pays only for the modules that it uses.
"""
