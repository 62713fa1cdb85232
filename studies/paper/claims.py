"""Claims of the paper's text, each with the run that checks it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pmfid.errors import UsageError
from pmfid.simulation import CART, CART_DT, CART_LOADED, make_scenario, prbs, quantize, resolution_of, simulate_drive
from studies.paper.designs import FILTER, PULSES, stroke_record
from studies.paper.inputs import experiments
from studies.paper.result import Finding, Verdict, judge
from studies.paper.runs import CUTOFF, INCREMENTS, controlled, known_mass, mass_errors, step_at, track
from studies.paper.truth import CartRecord, make_estimator

FINE = 2**24
METHODS = ("rls", "bcrls", "riv")
SMALL, LARGE = 150.0, 20.0  # [rad/s]: filter time constants of 7 and 50 ms


@dataclass(frozen=True)
class Claim:
    """A statement of the paper, the section that holds it, and its check for a number of seeds."""

    section: str
    statement: str
    check: Callable[[int], Finding]


def records_of(increments: int, seeds: int, duration: float = 20.0) -> list[CartRecord]:
    return [controlled(increments, seed, duration) for seed in range(seeds)]


def check_noise(seeds: int) -> Finding:
    """Variance and correlation of the floor's error with a fine and with a coarse encoder (paper eq. 2, 3)."""
    drive = simulate_drive(CART, prbs(6000, clock=10, amplitude=3.0, rng=np.random.default_rng(0)), CART_DT)
    travel, found = float(np.abs(np.diff(drive.x)).mean()), []
    for increments in (4096, 16):
        resolution = resolution_of(increments)
        error = drive.x - resolution * quantize(drive.x, resolution, 0.0)
        correlation = float(np.corrcoef(error[:-1], error[1:])[0, 1])
        found.append((travel / resolution, float(np.var(error) / (resolution**2 / 12)), correlation))
    (fine, variance, white), (coarse, _, coloured) = found
    return Finding(
        judge(abs(variance - 1) < 0.05 and abs(white) < 0.05 < abs(coloured), Verdict.LIMITED),
        f"At {fine:.0f} counts per sample the variance is {variance:.2f} times Δ²/12, and neighbouring errors have the "
        f"correlation {white:+.2f}. At {coarse:.1f} counts per sample the correlation is {coloured:+.2f}.",
    )


def check_large_filters(seeds: int) -> Finding:
    """RLS with large and with small filter time constants."""
    large, small = (mass_errors("rls", records_of(512, seeds), cutoff)[0] for cutoff in (LARGE, SMALL))
    return Finding(
        judge(abs(large) < 1 < abs(small)),
        f"With 512 increments, RLS is off by {large:+.1f} % with filters of 50 ms, and by {small:+.1f} % with 7 ms.",
    )


def check_stationary_bias(seeds: int) -> Finding:
    """The bias of RLS over longer and longer records (paper eq. 17, 18)."""
    errors = [
        100
        * float(
            np.mean([track("rls", r, CUTOFF, 1.0)["mass"][-1] for r in records_of(512, seeds, duration)]) / CART.mass
            - 1
        )
        for duration in (10.0, 40.0, 160.0)
    ]
    return Finding(
        judge(all(error < -3 for error in errors)),
        "The error of RLS after 10, 40 and 160 s is " + ", ".join(f"{error:+.1f} %" for error in errors) + ".",
    )


def check_compensation(seeds: int) -> Finding:
    """The error of BCRLS over the encoders."""
    errors = [mass_errors("bcrls", records_of(n, seeds), CUTOFF)[0] for n in INCREMENTS]
    plain = mass_errors("rls", records_of(INCREMENTS[-1], seeds), CUTOFF)[0]
    return Finding(
        judge(np.ptp(errors) < 1 and abs(plain) > 10),
        f"From 4096 to 256 increments, the error of BCRLS stays within {min(errors):+.1f} and "
        f"{max(errors):+.1f} %. RLS is "
        f"off by {plain:+.1f} % with 256.",
    )


def check_rest(seeds: int) -> Finding:
    """BCRLS where the cart rests between moves, with an encoder that is nearly exact."""
    masses = []
    for seed in range(seeds):
        run = make_scenario("stop-and-go", seed=seed, increments=FINE, duration=20.0)
        record = CartRecord(run.motion.u, run.counts, run.resolution)
        masses.append(
            [track(method, record, LARGE, 1.0, own)["mass"][-1] for method, own in (("bcrls", False), ("riv", True))]
        )
    bcrls, riv = (100 * float(value / CART.mass - 1) for value in np.mean(masses, axis=0))
    return Finding(
        judge(abs(bcrls) < 0.5, Verdict.LIMITED),
        f"If the cart rests between moves, stiction makes sign(v) wrong. BCRLS is then off by {bcrls:+.1f} % "
        "even with an "
        f"encoder of {FINE} increments, and `riv`, which simulates stiction, by {riv:+.1f} %.",
    )


def check_speed(seeds: int) -> Finding:
    """Time for a tenth and for 63 % of a step of the mass, with small and with large filters."""
    step, pulse = 15.5, 16.0  # [s]; the first pulse of the reference after the step
    times = []
    for cutoff in (SMALL, 1.0):
        records = [controlled(4096, seed, 30.0, step_at(step)) for seed in range(seeds)]
        masses = [track("rls", record, cutoff)["mass"][round(step / CART_DT) :] for record in records]
        for part in (0.1, 0.63):
            target = CART.mass + part * (CART_LOADED.mass - CART.mass)
            times.append(CART_DT * float(np.median([np.argmax(mass > target) for mass in masses])) - (pulse - step))
    first, most, late, late_most = times
    return Finding(
        judge(first < late / 2 and most < late_most, Verdict.LIMITED if first < late / 2 else Verdict.REFUTED),
        f"After the next pulse, a tenth of a step takes {first:.2f} s with filters of 7 ms, and {late:.2f} s with 1 s. "
        f"For 63 %, {most:.1f} and {late_most:.1f} s pass, because the memory of 1 s decides.",
    )


def check_peaks(seeds: int) -> Finding:
    """Changes of the estimate within 0.2 s of a pulse of the reference, and elsewhere."""
    record = controlled(512, 1, 20.0)
    change = np.abs(np.diff(known_mass(track("rls", record))))[500:]
    near = (np.arange(500, 500 + change.size) + 1) % 100 < 20
    ratio = float(change[near].mean() / change[~near].mean())
    return Finding(
        judge(ratio > 2),
        f"Within 0.2 s after a pulse of the reference, the estimate of RLS changes {ratio:.1f} times as fast "
        "as elsewhere.",
    )


def check_start(seeds: int) -> Finding:
    """Errors in the first second, and what is reported meanwhile."""
    mass = known_mass(track("rls", controlled(4096, 1, 10.0), forgetting=1.0))
    first, later = (100 * float(np.nanmax(np.abs(part / CART.mass - 1))) for part in (mass[:100], mass[100:]))
    hidden = CART_DT * int(np.isnan(mass).sum())
    return Finding(
        judge(first > 2 * later),
        f"The largest error of RLS is {first:.0f} % in the first second and {later:.1f} % later. The first "
        f"{hidden:.2f} s "
        "have the status `starting`, because the filters have not settled.",
    )


def check_zeros(seeds: int) -> Finding:
    """Two equal zeros of f(s) (paper eq. 29)."""
    record = controlled(4096, 0, 5.0)
    try:
        make_estimator("bcrls", record, prefilter_zeros=(-20.0, -20.0))
    except UsageError as error:
        return Finding(Verdict.CONFIRMED, f"Equal zeros are refused: {str(error).partition(';')[0]}.")
    return Finding(Verdict.REFUTED, "Equal zeros are accepted.")


def check_discretisation(seeds: int) -> Finding:
    """Errors of the mass without noise, with the paper's and with the matched discretisation."""
    paper, matched = (mass_errors("rls", records_of(FINE, 1), CUTOFF, own)[0] for own in (False, True))
    return Finding(
        judge(abs(matched) < abs(paper)),
        f"With an encoder of {FINE} increments, RLS is off by {paper:+.2f} % with the bilinear filters, and by "
        f"{matched:+.2f} % with the matched ones.",
    )


def check_every_method(seeds: int) -> Finding:
    """RMS error of each method under pulses and under the design."""
    names = (*PULSES, "design (5)")
    rms = {(name, method): _rms(name, method, seeds) for name in names for method in METHODS}
    ratios = {method: min(rms[name, method] for name in PULSES) / rms[names[-1], method] for method in METHODS}
    return Finding(
        judge(min(ratios.values()) > 1),
        "The RMS error falls by these factors against the better one of the two kinds of pulses: "
        + ", ".join(f"{ratio:.0f} (`{method}`)" for method, ratio in ratios.items())
        + ".",
    )


def _rms(name: str, method: str, seeds: int) -> float:
    """Return the RMS error [%] of the mass after six strokes, with filters of 100 ms."""
    records = [stroke_record(experiments()[name], seed) for seed in range(seeds)]
    masses = [track(method, record, 1 / FILTER, 1.0, method == "riv")["mass"][-1] for record in records]
    return 100 * float(np.sqrt(np.mean((np.array(masses) / CART.mass - 1) ** 2)))


def check_stationary_error(seeds: int) -> Finding:
    """What is left of the error of RLS and BCRLS under the design."""
    rls, bcrls = (_rms("design (5)", method, seeds) for method in ("rls", "bcrls"))
    return Finding(
        judge(bcrls < rls),
        f"With filters of 100 ms and 4096 increments, the filters remove the noise: RLS is off by {rls:.2f} %, "
        "BCRLS by "
        f"{bcrls:.2f} %. A larger error on a real cart would come from the cart, not from the encoder.",
    )


CLAIMS = (
    Claim("II, eq. 2, 3", "Quantisation is white noise if the output changes enough between samples.", check_noise),
    Claim("III-A", "More accurate approximations than the bilinear rule are possible.", check_discretisation),
    Claim("III-B", "RLS is usable for low noise and large filter time constants.", check_large_filters),
    Claim("III-B, eq. 17, 18", "The bias of RLS does not vanish with more samples.", check_stationary_bias),
    Claim("III-B, eq. 29", "The zeros of f(s) must be distinct.", check_zeros),
    Claim("IV-A, footnote", "The sign of the velocity may be taken from the measured position.", check_rest),
    Claim("IV-C", "Small filter time constants detect rapid changes.", check_speed),
    Claim("IV-C", "BCRLS gives similar results with every resolution.", check_compensation),
    Claim("IV-C", "Oscillations in the first second come from the filters.", check_start),
    Claim("IV-C", "Oscillations at constant mass come from narrow peaks of the input.", check_peaks),
    Claim("IV-C, figure 5", "Under the design, BCRLS must remove the remaining error of RLS.", check_stationary_error),
    Claim("V", "The designed input improves the estimate of every method.", check_every_method),
)
