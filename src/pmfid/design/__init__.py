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
    from pmfid.design.problem.fisher import information as information
    from pmfid.design.problem.fisher import sensitivities as sensitivities
    from pmfid.design.problem.problem import InfeasibleError as InfeasibleError
    from pmfid.design.problem.problem import Limits as Limits
    from pmfid.design.problem.problem import Problem as Problem
    from pmfid.design.problem.result import Design as Design
    from pmfid.design.search.campaign import campaign as campaign
    from pmfid.design.search.evaluation import evaluate as evaluate
    from pmfid.design.search.solver import price_of_robustness as price_of_robustness
    from pmfid.design.search.solver import solve as solve
    from pmfid.design.search.standard import standard_inputs as standard_inputs
    from pmfid.design.trial.appraisal import appraise as appraise
    from pmfid.design.trial.calibration import DesignedRun as DesignedRun
    from pmfid.design.trial.calibration import calibrate as calibrate
    from pmfid.design.trial.sequential import sequential as sequential
    from pmfid.design.trial.sequential import simulated_experiment as simulated_experiment

_PUBLIC = {
    "Design": "problem.result",
    "DesignedRun": "trial.calibration",
    "InfeasibleError": "problem.problem",
    "Limits": "problem.problem",
    "Problem": "problem.problem",
    "appraise": "trial.appraisal",
    "calibrate": "trial.calibration",
    "campaign": "search.campaign",
    "evaluate": "search.evaluation",
    "information": "problem.fisher",
    "price_of_robustness": "search.solver",
    "sensitivities": "problem.fisher",
    "sequential": "trial.sequential",
    "simulated_experiment": "trial.sequential",
    "solve": "search.solver",
    "standard_inputs": "search.standard",
}

__all__ = sorted(_PUBLIC)
__getattr__ = make_getattr(__name__, _PUBLIC)


def __dir__() -> list[str]:
    return list(__all__)
