"""Run `python -m studies.monitoring`; the work is in `run`, so that subprocesses can import it."""

import sys

from studies.monitoring.run import main

if __name__ == "__main__":
    sys.exit(main())
