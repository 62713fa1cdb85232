"""Optimal inputs: the most information within the limits of the machine, with a proved distance to the optimum.

problem = Problem(Drive(2.0), {"mass": 1.5, ...}, ("mass",), horizon=2.0, intervals=40, limits=Limits(input=3.0), ...)
design = solve(problem, certify=5.0)        # the input, its information, and a bound of the optimum
appraise(design)                            # compared with the standard inputs, with the encoder's error
sequential(problem, experiment, ...)        # design, run, estimate, and design again
rank(problem)                               # two masses, springs, dead times, ...: standard inputs, the best improved
solve_plant(PlantProblem(matrices, ...))    # any plant x' = A x + b u, y = c x (paper eq. 5)
"""

from pmfid.design.appraisal import appraise
from pmfid.design.calibration import DesignedRun, calibrate
from pmfid.design.fisher import information
from pmfid.design.plant import PlantDesign, PlantProblem, evaluate_plant_input, solve_plant
from pmfid.design.problem import Design, InfeasibleError, Limits, Problem
from pmfid.design.ranking import rank
from pmfid.design.rounds import sequential, simulated_experiment
from pmfid.design.solver import evaluate, solve
from pmfid.design.standard import standard_inputs

__all__ = [
    "Design",
    "DesignedRun",
    "InfeasibleError",
    "Limits",
    "PlantDesign",
    "PlantProblem",
    "Problem",
    "appraise",
    "calibrate",
    "evaluate",
    "evaluate_plant_input",
    "information",
    "rank",
    "sequential",
    "simulated_experiment",
    "solve",
    "solve_plant",
    "standard_inputs",
]
