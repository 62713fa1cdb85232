"""The service under load, for an hour, and under faults: broker, machines and `pmfid serve` as processes."""

import os

# set before NumPy is loaded, as in the command: another number of threads adds in another order
for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(variable, "1")
