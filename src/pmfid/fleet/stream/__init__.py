"""Many axes watched as a stream, on whatever keeps the state of each shard; `pmfid.fleet.spark` runs it on Spark."""
