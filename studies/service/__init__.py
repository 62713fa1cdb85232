"""The service under load, for an hour, and under faults: broker, machines and `pmfid serve` as processes."""
