"""Study: what predicts a motion best? `python -m studies.prediction --out docs/prediction.md`."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from studies.prediction_cart import STUDY as CART
from studies.prediction_emps import STUDY as EMPS
from studies.prediction_machines import BARS
from studies.prediction_machines import STUDY as MACHINES
from studies.sections import Page, by_name

INTRODUCTION = """\
A model is worth what it predicts on records that it has not seen, simulated from the input alone: `pmfid validate`.
The start of every run is read from its first samples, over five filter time constants; nothing else of the output is
used. Friction that a model lacks adds up in the position, so that the longer the run, the more is left to chance: the
same runs begun anew every few seconds say more on the model."""
PAGE = Page("prediction", "Prediction", INTRODUCTION, by_name(EMPS, CART, MACHINES, BARS), 1, {"bars": 40.0})


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the study and writes the page; returns the exit code."""
    return PAGE.main(__doc__, arguments)


if __name__ == "__main__":
    sys.exit(main())
