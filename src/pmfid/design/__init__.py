"""Optimal inputs: the most information within the limits of the machine, and how near that is to the optimum.

problem = Problem(Drive(2.0), {"mass": 1.5, ...}, ("mass",), horizon=2.0, intervals=40, limits=Limits(input=3.0), ...)
design = solve(problem, certify=5.0)        # the input, its information, and how near the optimum it is
appraise(design)                            # compared with the standard inputs, with the encoder's error
sequential(problem, experiment, ...)        # design, run, estimate, and design again
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from pmfid.lazy_imports import make_getattr

if TYPE_CHECKING:
    from pmfid.design.appraisal import appraise as appraise
    from pmfid.design.calibration import DesignedRun as DesignedRun
    from pmfid.design.calibration import calibrate as calibrate
    from pmfid.design.campaigns import campaign as campaign
    from pmfid.design.fisher import information as information
    from pmfid.design.fisher import sensitivities as sensitivities
    from pmfid.design.problem import Design as Design
    from pmfid.design.problem import InfeasibleError as InfeasibleError
    from pmfid.design.problem import Limits as Limits
    from pmfid.design.problem import Problem as Problem
    from pmfid.design.rounds import sequential as sequential
    from pmfid.design.rounds import simulated_experiment as simulated_experiment
    from pmfid.design.solver import evaluate as evaluate
    from pmfid.design.solver import price_of_robustness as price_of_robustness
    from pmfid.design.solver import solve as solve
    from pmfid.design.standard import standard_inputs as standard_inputs

_PUBLIC = {
    "Design": "problem",
    "DesignedRun": "calibration",
    "InfeasibleError": "problem",
    "Limits": "problem",
    "Problem": "problem",
    "appraise": "appraisal",
    "calibrate": "calibration",
    "campaign": "campaigns",
    "evaluate": "solver",
    "information": "fisher",
    "price_of_robustness": "solver",
    "sensitivities": "fisher",
    "sequential": "rounds",
    "simulated_experiment": "rounds",
    "solve": "solver",
    "standard_inputs": "standard",
}

__all__ = sorted(_PUBLIC)
__getattr__ = make_getattr(__name__, _PUBLIC)


def __dir__() -> list[str]:
    return list(__all__)
