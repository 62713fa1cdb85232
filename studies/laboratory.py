"""Write the page of the laboratory: `python -m studies.laboratory --out results/laboratory.md --images
results/images`.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from shutil import copyfile

from pmfid.errors import UsageError
from pmfid.simulation import SCENARIOS
from studies.exactness import RTOL, agreement
from studies.paper.merit import Merit
from studies.paper.page import PICTURES, sections
from studies.paper.run import SEEDS, reproduce
from studies.paper.truth import table

HEAD = """\
# The laboratory

Written by

    python -m studies.laboratory --out results/laboratory.md --images results/images

A cart on a rack, driven by a voltage and watched by an encoder, as in the paper: 1.07 kg (1.44 kg with its load),
12.8 N s/m, 0.8 N of Coulomb friction with stiction, 2 N/V, a sample every 10 ms; an encoder of 4096 increments has
22.75 µm per count. The paper gives the encoder, the sample period and the machine constant; mass and friction are ours.
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the page and its pictures; return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m studies.laboratory", description=__doc__)
    parser.add_argument("--out", type=Path, required=True, help="Markdown page to write")
    parser.add_argument("--images", type=Path, required=True, help="folder of the pictures")
    parser.add_argument("--seeds", type=int, default=SEEDS, help="runs of each row (default: %(default)s)")
    parser.add_argument("--jobs", type=int, help="processes (default: one for each core)")
    options = parser.parse_args(arguments)
    try:
        with tempfile.TemporaryDirectory() as folder:
            rows = reproduce((), Path(folder), options.seeds, options.jobs)
            options.images.mkdir(parents=True, exist_ok=True)
            for picture in (picture for pictures in PICTURES.values() for picture in pictures):
                copyfile(Path(folder) / f"{picture}.png", options.images / f"{picture}.png")
        images = os.path.relpath(options.images, options.out.parent)
        options.out.write_text(page(rows, images, options.seeds), encoding="utf-8")
    except (UsageError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


def page(rows: Sequence[Merit], images: str, seeds: int) -> str:
    """Return the page; `images` is the relative folder of the pictures, `seeds` the number of runs of each row."""
    scenarios = table(["scenario", ""], [[f"`{name}`", recipe.summary] for name, recipe in SCENARIOS.items()])
    lines = [HEAD, *scenarios, *_exactness(), *_figures(seeds), *sections(rows, images)]
    return "\n".join(lines).rstrip("\n") + "\n"


def _exactness() -> list[str]:
    found = agreement()
    return [
        "## How exact it is",
        "",
        "The drive is solved from event to event, without a time step. Against SciPy's DOP853 with event location "
        f"(rtol {RTOL:g}) over {found.duration:g} s with {found.reversals} reversals, {found.at_rest} samples at rest "
        f"and {found.events} with a stop or a reversal inside: position {found.position:.1e} m, velocity "
        f"{found.velocity:.1e} m/s. The tests hold it to 1e-8, check the balance of energy for random drives and "
        "inputs, and ask for a million samples per second, encoder and controller included.",
        "",
    ]


def _figures(seeds: int) -> list[str]:
    return [
        "## The paper's figures",
        "",
        "    python -m studies.paper     # all of them: pictures, a CSV of what is drawn, table.csv",
        "    python -m studies.paper 3 4 --seeds 20 --out here",
        "",
        f"{seeds} runs for each row. A seed draws the place of the start on the encoder's lattice; stop-and-go and the "
        "inputs of figure 5 are otherwise the same in every run, so that a bias of theirs does not average out and the "
        "coverage of an interval is nearly all or nothing. `prbs` and `moves` have a random signal as well. "
        "`extended rls` is what BCRLS starts from, the first four lines of eq. 33 with the pre-filtered input; `auto` "
        "is off-line the likelihood of the counts, with forgetting `riv`.",
        "",
    ]


if __name__ == "__main__":
    sys.exit(main())
