"""Measure how the processor time of pmfid grows with samples, parameters, axes and increments, as a page:
`python -m studies.growth --out docs/benchmarks.md`.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from textwrap import wrap
from time import process_time
from types import MappingProxyType

import numpy as np

from pmfid import BCRLS, IV, LS, RIV, RLS, Drive, Encoder, Fleet, MotionFit, TransferFunction
from pmfid.encoder import fine_counts
from pmfid.estimators.recursive import RecursiveEstimator
from pmfid.simulation import CART, Schedule, prbs, quantize, simulate_drive
from pmfid.simulation.process import PLANTS, simulate_process
from pmfid.types import Counts, Floats
from studies.paper.truth import table

DT, CUTOFF, FORGETTING, RESOLUTION = 0.01, 50.0, 0.999, 22.75e-6
#: Samples of the simulated record. Longer records repeat it. Each repetition begins where the preceding one ends.
PERIOD = 100_000
SAMPLES, OFF_LINE, SIMULATED = (10_000, 100_000, 1_000_000, 10_000_000, 100_000_000), 1_000_000, 100_000
#: Orders of the process, samples of its record, numbers of axes, and samples of each axis.
ORDERS, PROCESS, AXES, OF_AXIS = (1, 2, 3, 4), 50_000, (10, 100, 1000, 10_000, 100_000, 1_000_000), 100
#: Recursive methods.
METHODS = (RLS, BCRLS, RIV)
#: Increments of an encoder over the travel that 1024 increments of the cart's encoder have, and samples of each record.
INCREMENTS, TRAVEL, COUNTED = (64, 256, 1024, 4096, 16_384, 65_536), 1024 * RESOLUTION, 5_000
#: Exponents by kind, and the distance from them that needs a reason. P has as many elements as parameters squared.
EXPECTED: Mapping[str, float] = MappingProxyType({"parameters": 2.0, "increments": 0.0, "axes": 1.0, "samples": 1.0})
STEP = 0.2
#: A measurement is repeated until it has taken this time [s], or has been repeated this often.
LEAST, MOST = 0.5, 20
#: Largest number of columns in the page's text.
WIDTH = 120
#: Reasons for steps by kind and method.
REASONS: Mapping[tuple[str, str], str] = MappingProxyType(
    {
        (
            "parameters",
            "`rls` `run`",
        ): "Encoder and filters take 28 to 45 ns per sample, which masks the quadratic growth for few parameters.",
        (
            "axes",
            "fleet of `bcrls`",
        ): "A call costs 14 us. The processor updates 8 axes at once, so 10 axes take as long as 16.",
        (
            "samples",
            "`ls` `fit`",
        ): "At the larger size, the operating system takes half of the time to provide 30 000 pages of memory.",
        (
            "samples",
            "`iv` `fit`",
        ): "At the larger size, the operating system takes half of the time to provide 140 000 pages of memory.",
        (
            "samples",
            "`interval` `fit`",
        ): "The search simulates 45 motions for 10 000 samples, and 328 motions for 100 000 samples.",
    }
)


@dataclass(frozen=True)
class Growth:
    """The processor times [s] of one method over sizes of one kind. `per` is the number of samples at each size."""

    kind: str
    method: str
    sizes: tuple[int, ...]
    times: tuple[float, ...]
    per: tuple[int, ...]

    @property
    def local(self) -> list[float]:
        """The exponent between each pair of neighbouring sizes."""
        return list(np.diff(np.log(self.times)) / np.diff(np.log(self.sizes)))

    @property
    def whole(self) -> float:
        """The exponent of the straight line through all times, on logarithmic scales."""
        return float(np.polyfit(np.log(self.sizes), np.log(self.times), 1)[0])

    @property
    def steps(self) -> list[int]:
        """The numbers of the sizes after which the time grows in an unexpected way."""
        return [k for k, local in enumerate(self.local) if abs(local - EXPECTED[self.kind]) > STEP]

    def cells(self) -> Iterator[list[str]]:
        """Yield a row of the table for each size."""
        for k, (size, time, samples) in enumerate(zip(self.sizes, self.times, self.per, strict=True)):
            bold = "**" * (k - 1 in self.steps)
            exponent = f"{bold}{self.local[k - 1]:.2f}{bold}" if k else ""
            yield [
                self.kind if not k else "",
                f"{self.method}, {self.whole:.2f}" if not k else "",
                f"{size:,}".replace(",", " "),
                f"{time:.3g}",
                f"{time / samples * 1e9:.3g}",
                exponent,
            ]


def measure(run: Callable[[], object], reset: Callable[[], object] | None = None) -> float:
    """Return the least processor time of one call [s], because all other calls show the load of others."""
    times = list[float]()
    while len(times) < MOST and sum(times) < LEAST:
        if reset is not None:
            reset()
        begun = process_time()
        run()
        times.append(process_time() - begun)
    return min(times)


def cart(samples: int, resolution: float = RESOLUTION) -> tuple[Floats, Counts]:
    """Return input and counts (samples,) of the simulated cart."""
    rng = np.random.default_rng(1)
    u = prbs(min(samples, PERIOD), clock=10, amplitude=3.0, rng=rng)
    u = np.r_[u, -u] if samples > PERIOD else u  # the second half goes back
    x = simulate_drive(Schedule(((0.0, CART),)), u, DT).x
    turns = -(-samples // u.size)
    counts = quantize(x, resolution)
    whole = (counts + np.arange(turns)[:, None] * (counts[-1] - counts[0])).ravel()
    return np.resize(u, samples), whole[:samples]


def recursive(method: type[RecursiveEstimator]) -> RecursiveEstimator:
    """Return a recursive estimator of the cart."""
    return method(Drive(CART.input_gain), Encoder(RESOLUTION), DT, CUTOFF, forgetting=FORGETTING)


def off_line(method: type[LS] | type[IV] | type[MotionFit], resolution: float = RESOLUTION) -> LS | IV | MotionFit:
    """Return an off-line estimator of the cart."""
    return method(Drive(CART.input_gain), Encoder(resolution), DT, CUTOFF)


def by_samples(most: int) -> Iterator[Growth]:
    """Yield the growth of recursive and off-line methods with the samples of one axis."""
    for method in METHODS:
        sizes, times = tuple(size for size in SAMPLES if size <= most), list[float]()
        for size in sizes:
            fleet, (u, counts) = Fleet(recursive(method), 1, workers=1), cart(size)
            times.append(measure(partial(fleet.run, u[None], counts[None]), fleet.reset))
        yield Growth("samples", f"`{method.method}` `run`", sizes, tuple(times), sizes)
    for whole, limit in ((LS, OFF_LINE), (IV, OFF_LINE), (MotionFit, SIMULATED)):
        sizes = tuple(size for size in SAMPLES if size <= min(limit, most))
        found = tuple(measure(partial(off_line(whole).fit, *cart(size))) for size in sizes)
        yield Growth("samples", f"`{whole.method}` `fit`", sizes, found, sizes)


def by_parameters() -> Iterator[Growth]:
    """Yield the growth of a recursion with the parameters of a process."""
    plant = PLANTS["rao-garnier"]
    u = prbs(PROCESS, clock=10, amplitude=1.0, rng=np.random.default_rng(1))
    y = simulate_process(np.array(plant.b), np.array(plant.a), u, plant.dt)
    encoder, counts = fine_counts(y)
    times, sizes = list[float](), tuple(2 * order for order in ORDERS)
    for order in ORDERS:
        estimator = RLS(TransferFunction(order, order - 1), encoder, plant.dt, plant.cutoff, forgetting=FORGETTING)
        times.append(measure(partial(estimator.run, u, counts), estimator.reset))
    yield Growth("parameters", "`rls` `run`", sizes, tuple(times), (PROCESS,) * len(sizes))


def by_axes(most: int) -> Iterator[Growth]:
    """Yield the growth of fleets on one thread with the number of axes."""
    u, counts = cart(PERIOD)
    for method in METHODS[1:]:
        times, sizes = list[float](), tuple(size for size in AXES if size <= most)
        for size in sizes:
            starts = np.random.default_rng(size).integers(0, PERIOD - OF_AXIS, size)
            at = starts[:, None] + np.arange(OF_AXIS)
            rows = u.astype(np.float32)[at], counts.astype(np.int32)[at]
            fleet = Fleet(recursive(method), size, workers=1)
            times.append(measure(partial(fleet.run, *rows), fleet.reset))
        yield Growth("axes", f"fleet of `{method.method}`", sizes, tuple(times), tuple(OF_AXIS * n for n in sizes))


def by_increments() -> Iterator[Growth]:
    """Yield the growth of methods with the increments of the encoder."""
    records = {many: cart(COUNTED, TRAVEL / many) for many in INCREMENTS}
    fleets = {many: Fleet(recursive(BCRLS), 1, workers=1) for many in INCREMENTS}
    found = [measure(partial(fleets[many].run, u[None], counts[None])) for many, (u, counts) in records.items()]
    per = (COUNTED,) * len(INCREMENTS)
    yield Growth("increments", "`bcrls` `run`", INCREMENTS, tuple(found), per)
    for method in (IV, MotionFit):
        found = [measure(partial(off_line(method, TRAVEL / many).fit, *records[many])) for many in INCREMENTS]
        yield Growth("increments", f"`{method.method}` `fit`", INCREMENTS, tuple(found), per)


def page(found: Sequence[Growth]) -> str:
    """Return the page, with a line for each step."""
    header = (
        "grows with",
        "method, exponent",
        "size",
        "processor [s]",
        "ns per sample",
        "exponent from the preceding size",
    )
    lines = [
        "# How the processor time grows",
        "",
        *wrap(
            "`python -m studies.growth` writes this page. Each time is the shortest of several calls on one thread. "
            f"Most rows use the simulated cart (1.07 kg) at 100 Hz, with float64 and a cutoff of {CUTOFF:g} rad/s. "
            f"Records of more than {PERIOD} samples repeat a shorter record. Each repetition begins at the position "
            "where the preceding repetition ends. In the rows on parameters, `rls` fits a transfer function with this "
            f"number of parameters to {PROCESS} samples. In the rows on axes, the fleet has {OF_AXIS} samples of each "
            f"axis. In the rows on increments, the size is the number of increments within {1000 * TRAVEL:.0f} mm of "
            f"travel, and each record has {COUNTED} samples. An exponent of 1 means that twice the size takes twice "
            f"the time. Bold exponents differ by more than {STEP:g} from the expected exponents "
            f"({', '.join(f'{kind} {value:g}' for kind, value in EXPECTED.items())}).",
            WIDTH,
        ),
        "",
        *table(header, [cells for one in found for cells in one.cells()]),
        "## Steps",
        "",
    ]
    for one in found:
        for k in one.steps:
            reason = REASONS.get((one.kind, one.method), "Not explained.")
            lines += [f"- {one.method}, {one.sizes[k]} to {one.sizes[k + 1]} {one.kind}.", f"  {reason}"]
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, help="the page")
    parser.add_argument("--samples", type=int, default=10_000_000, help="most samples (default: %(default)s)")
    parser.add_argument("--axes", type=int, default=100_000, help="most axes (default: %(default)s)")
    options = parser.parse_args()
    found = list[Growth]()
    for rows in (by_parameters(), by_increments(), by_axes(options.axes), by_samples(options.samples)):
        for one in rows:
            found.append(one)
            print(f"{one.kind}, {one.method}: {one.whole:.2f}", *(f"{x:.2f}" for x in one.local), flush=True)
    text = page(found)
    if options.out is not None:
        options.out.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
