"""Thresholds, limits and counts of `pmfid.testing`, each with its purpose."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, init=False, repr=False, eq=False)
class TestingTuning:
    """The constants of `pmfid.testing`, grouped by module."""

    # case
    case_samples: int = 3000
    #: Changes of the random input in the shortest record.
    case_changes: int = 250
    #: Duration of an input step in time constants of the filters, for a drive and a process.
    drive_hold: float = 3.0
    process_hold: float = 0.8
    #: Time constant of a drive in those of the filters, friction and load as fractions of the force, and the ratio of
    #: backward to forward friction.
    drive_time: float = 3.0
    case_coulomb: float = 0.15
    case_load: float = 0.05
    case_backward: float = 1.3
    #: Natural frequency of a drive on a spring, as a fraction of the cutoff.
    case_spring: float = 0.2
    #: Frequencies of a process's poles, their damping, and its zeros. Frequencies and zeros are fractions of the
    #: cutoff.
    case_frequencies: tuple[float, float, float] = (0.5, 0.2, 0.8)
    case_damping: float = 0.5
    case_zeros: float = -1.5
    #: An unknown dead time [samples].
    case_late: float = 2.5
    #: Standard deviation of a process, as a multiple of a drive's motion in a sample.
    case_range: float = 100.0
    #: Counts in a sample, roughly. The encoder has no effect at case_fine and a visible one at case_coarse.
    case_fine: float = 5000.0
    case_coarse: float = 5.0
    #: Samples that are enough for every method.
    case_short: int = 1000

    # common
    #: Greatest relative error of the parameters on a fine record.
    common_near: float = 0.1
    #: Greatest relative difference after a change of units or signs, caused by the rounding to counts.
    common_same: float = 1e-3
    common_mirrored: float = 5e-3
    #: Factor between two units of position.
    common_thousand: float = 1000.0
    #: Factor of the sample period in a second configuration, chosen so that every cutoff stays valid.
    other_dt: float = 0.5

    # contract
    contract_symmetric: float = 1e-9
    #: Samples before and after a copy or a saved state.
    contract_before: int = 1000
    contract_after: int = 400
    #: Greatest relative difference between the two precisions.
    contract_single: float = 2e-3
    hostile_samples: int = 20_000


TUNING = TestingTuning()
