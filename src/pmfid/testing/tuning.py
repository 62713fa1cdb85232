"""Thresholds, limits and counts of `pmfid.testing`, each with what it decides."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, init=False, repr=False, eq=False)
class TestingTuning:
    """One value for each decision of `pmfid.testing`, by module."""

    # case
    case_samples: int = 3000
    #: Changes of a random input in the shortest record.
    case_changes: int = 250
    #: Of the time constant of the filters: how long an input lasts, of a drive and of a process.
    drive_hold: float = 3.0
    process_hold: float = 0.8
    #: Time constant of a drive in those of the filters; friction and load as parts of the force; what differs backward.
    drive_time: float = 3.0
    case_coulomb: float = 0.15
    case_load: float = 0.05
    case_backward: float = 1.3
    #: Natural frequency on a spring, as a part of the cutoff.
    case_spring: float = 0.2
    #: Poles of a process as parts of the cutoff: frequency of each pair, or of what is left over; damping; zeros.
    case_frequencies: tuple[float, float, float] = (0.5, 0.2, 0.8)
    case_damping: float = 0.5
    case_zeros: float = -1.5
    #: A dead time that is to be found, in samples.
    case_late: float = 2.5
    #: Standard deviation of a process, in times what a drive moves in a sample.
    case_range: float = 100.0
    #: Counts in a sample, by the order of size: with case_fine the encoder does not matter, with case_coarse it does.
    case_fine: float = 5000.0
    case_coarse: float = 5.0
    #: Samples of a part that every method has enough of.
    case_short: int = 1000

    # common
    #: Greatest relative error of the parameters on a fine record.
    common_near: float = 0.1
    #: Greatest relative difference after a change of units or signs, because counts are whole numbers.
    common_same: float = 1e-3
    common_mirrored: float = 5e-3
    #: Units of position in one of another choice.
    common_thousand: float = 1000.0
    #: Another sample time, at which every cutoff that was allowed still is.
    other_dt: float = 0.5

    # contract
    contract_symmetric: float = 1e-9
    #: Samples before a copy is made or a state saved, and after it.
    contract_before: int = 1000
    contract_after: int = 400
    #: Relative difference of the two precisions.
    contract_single: float = 2e-3
    hostile_samples: int = 20_000


TUNING = TestingTuning()
