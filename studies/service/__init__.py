"""The service under load, for an hour, and under faults: a broker, machines and `pmfid serve` as processes of their own."""
