"""Study which method predicts a motion best: `python -m studies.prediction --out results/prediction.md`."""

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
same runs restarted every few seconds say more on the model.

Which friction the model has decides more than the method. Least squares of the force balance alone (`ls`) is lost with
a coarse encoder. Where the model lacks nothing, windows cost nothing, for then one window over all is chosen; where it
lacks something, they stand between the whole position, best over the longest runs where it gives an estimate at all,
and the force balance, best over the shortest. No method is the best everywhere, and none makes up for friction that
differs by direction in a model that has none of it."""
PAGE = Page("prediction", "Prediction", INTRODUCTION, by_name(EMPS, CART, MACHINES, BARS), 1, {"bars": 40.0})


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the study, write the page, and return the exit code."""
    return PAGE.main(__doc__, arguments)


if __name__ == "__main__":
    sys.exit(main())
