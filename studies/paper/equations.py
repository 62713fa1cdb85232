"""The index of the paper's equations: what each one says, the code that computes it, and the test that holds it."""

from __future__ import annotations

import ast
import importlib
import re
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from studies.paper.result import table

ROOT = Path(__file__).parents[2]


@dataclass(frozen=True)
class Row:
    """Equations from `first` to `last` of the paper.

    `code` is "module:name" and `test` is "file:name" in the folder of tests. `note` gives the difference from the text
    of the paper.
    """

    first: int
    last: int
    symbol: str
    here: str
    code: str
    test: str
    note: str = ""


INDEX = (
    Row(
        1,
        1,
        "A(p), b(p), c(p)",
        "`matrices`",
        "pmfid.design.plant:PlantProblem",
        "test_design_plant:test_sensitivities_are_the_derivatives_of_the_simulated_output",
    ),
    Row(
        2,
        2,
        "y_m = y + v",
        "`resolution**2 / 12`",
        "pmfid.design.problem:Problem",
        "test_paper:test_a_claim_has_the_verdict_of_the_page",
    ),
    Row(3, 3, "y_quant", "`quantize`", "pmfid.encoder:quantize", "test_simulation:test_quantize"),
    Row(
        4,
        4,
        "F(u, p)",
        "`information`",
        "pmfid.design.fisher:information",
        "test_design_fisher:test_information_of_a_free_mass_has_a_closed_form",
    ),
    Row(
        5,
        5,
        "max trace F, any plant",
        "`solve_plant`",
        "pmfid.design.plant:solve_plant",
        "test_design_plant:test_the_best_input_of_few_intervals_is_the_best_vertex",
    ),
    Row(
        5,
        5,
        "S_x, s_y",
        "`PlantProblem.response`",
        "pmfid.design.plant:PlantProblem",
        "test_design_plant:test_sensitivities_are_the_derivatives_of_the_simulated_output",
    ),
    Row(
        6,
        7,
        "a_i, b_j, p",
        "`TransferFunction`",
        "pmfid.models.transfer_function:TransferFunction",
        "test_transfer_function:test_without_noise_little_but_the_bias_of_the_matched_filter_is_left",
    ),
    Row(
        8,
        9,
        "M_k, G_F, λ",
        "`chain`, `cutoff`",
        "pmfid.filters.chain:chain",
        "test_transfer_function:test_the_chain_of_the_kernel_is_the_coefficient_matrix_with_unit_gain",
        "The paper calls λ a time constant; λ is a pole. Each stage has unit gain.",
    ),
    Row(
        10,
        11,
        "M_k of a derivative",
        "`derivative`",
        "pmfid.filters.chain:derivative",
        "test_filters:test_derivatives_of_the_chain_are_the_trapezoidal_filters",
    ),
    Row(
        12,
        14,
        "φ, y_PMF, w",
        "`ColumnBuilder`: `regressors`, `target`",
        "pmfid.filters.columns:ColumnBuilder",
        "test_transfer_function:test_columns_are_those_of_the_oracle",
    ),
    Row(
        15,
        16,
        "A_n",
        "`coefficient_matrix`",
        "tests.oracles.paper:coefficient_matrix",
        "test_transfer_function:test_the_coefficient_matrix_of_the_paper_filters_derivatives",
        "The exponent of β is n+1-j in place of n+i-j. The matrix is (n+1) × (n+1).",
    ),
    Row(
        17,
        18,
        "p_B, R_φφ, R_φw",
        "`LS`",
        "pmfid.estimators.ls:LS",
        "test_transfer_function:test_compensation_takes_out_the_bias_of_white_noise",
    ),
    Row(
        19,
        21,
        "f(s), z_i, U^e, p^e",
        "`prefilter_input`, `prefilter_zeros`",
        "pmfid.filters.columns:ColumnBuilder",
        "test_recursion:test_bcls_is_the_papers_compensation",
        "Parameters and powers have one order; the paper mixes ascending and descending ones.",
    ),
    Row(
        22,
        22,
        "G",
        "`Equation.noisy`",
        "pmfid.models.equation:Equation",
        "test_recursion:test_bcls_is_the_papers_compensation",
    ),
    Row(
        23,
        25,
        "b^e(z_i) = 0, Z",
        "`process_facts`, `facts`",
        "tests.oracles.paper:process_facts",
        "test_transfer_function:test_compensation_is_that_of_the_paper",
        "For a known input gain β the right side is -β, not 0.",
    ),
    Row(
        26,
        32,
        "ε, R_yw, Δp, p_BC",
        "`compensate`",
        "tests.oracles.paper:compensate",
        "test_recursion:test_bcls_is_the_papers_compensation",
        "The kernel solves an equivalent instrumental variable equation, see `BCRLS`.",
    ),
    Row(
        33,
        33,
        "Φ, P, e, p_B, λ_est",
        "`RLS`, `forgetting`",
        "pmfid.estimators.recursive:RLS",
        "test_recursion:test_recursive_equals_batch_without_forgetting",
    ),
    Row(
        33,
        33,
        "p_BC (recursive)",
        "`BCRLS`",
        "pmfid.estimators.recursive:BCRLS",
        "test_recursion:test_bcrls_follows_the_papers_recursion",
    ),
    Row(
        34,
        35,
        "H, J_i",
        "`facts`, `J`",
        "tests.oracles.paper:facts",
        "test_recursion:test_bcls_is_the_papers_compensation",
        "The printed matrix is Hᵀ.",
    ),
    Row(
        36,
        36,
        "γ_i",
        "`tustin_image`",
        "pmfid.filters.columns:tustin_image",
        "test_filters:test_tustin_image_is_the_exact_pole",
        "γ = exp(zT) is the exact pole. The bilinear step is in (35).",
    ),
    Row(
        37,
        37,
        "x, v, m, d, F_C, β",
        "`DriveParameters`",
        "pmfid.simulation.drive:simulate_drive",
        "test_simulation:test_agrees_with_an_ode_solver_over_ten_seconds",
        "F_C is a force here, as in (42); in (37) and (39) it is an acceleration.",
    ),
    Row(
        38,
        38,
        "equivalent m and d",
        "`mass`, `viscous_friction`",
        "pmfid.models.drive:Drive",
        "test_estimators:test_matched_filters_without_noise",
        "Only the sums can be identified.",
    ),
    Row(
        39,
        40,
        "F for the mass, v > 0",
        "`Problem`, `min_speed`",
        "pmfid.design.problem:Problem",
        "test_design_plant:test_the_drive_of_the_paper_is_one_of_these_plants",
    ),
    Row(
        41,
        42,
        "φ, y, p^e of the cart",
        "`Drive.equation`",
        "pmfid.models.drive:Drive",
        "test_filters:test_kernel_columns_equal_the_oracle",
        "The target is the filtered u^e times β; the paper prints u_A.",
    ),
    Row(
        43,
        43,
        "F_0, F_1, α_i",
        "`cutoff`, `order`",
        "pmfid.filters.columns:FilterSpec",
        "test_filters:test_derivatives_of_the_chain_are_the_trapezoidal_filters",
        "Here α_0 = λ² and α_1 = 2 λ.",
    ),
)


@cache
def tests_of(file: str) -> frozenset[str]:
    """Return the names of the functions in a file of tests."""
    tree = ast.parse((ROOT / "tests" / f"{file}.py").read_text(encoding="utf-8"))
    return frozenset(node.name for node in tree.body if isinstance(node, ast.FunctionDef))


def check_row(row: Row) -> None:
    """Raise LookupError if the code or the test of a row does not exist."""
    module, _, name = row.code.partition(":")
    if not hasattr(importlib.import_module(module), name):
        raise LookupError(f"{module} has no {name}")
    for word in re.findall(r"`(?:\w+\.)*(\w+)`", row.here):
        if not re.search(rf"\b{word}\b", (ROOT / path_of(module)).read_text(encoding="utf-8")):
            raise LookupError(f"{path_of(module)} does not contain {word}")
    file, _, test = row.test.partition(":")
    if test not in tests_of(file):
        raise LookupError(f"tests/{file}.py has no {test}")


def path_of(module: str) -> str:
    """Return the path of a module in the repository."""
    folder = "src/" if module.startswith("pmfid") else ""
    return folder + module.replace(".", "/") + ".py"


def index_table() -> list[str]:
    """Return the index as a Markdown table. Raises LookupError if a row is out of date."""
    for row in INDEX:
        check_row(row)
    return table(
        ["equation", "symbol", "here", "file", "test", "difference from the text"],
        [
            [
                f"{row.first}" if row.first == row.last else f"{row.first} to {row.last}",
                row.symbol,
                row.here,
                f"`{path_of(row.code.partition(':')[0])}`",
                f"`{row.test.replace(':', '.py::')}`",
                row.note,
            ]
            for row in INDEX
        ],
    )
