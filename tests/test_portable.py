"""The same bits on every processor: constants of the kernel, exports, saved states and simulated records."""

from __future__ import annotations

import csv
import math
import os
import subprocess
import sys
from decimal import Decimal

import numpy as np
import pytest

from pmfid.elementary import cos_sin, exp, expm1, log, tanh
from pmfid.filters.chain import euler_frobenius, sampling_zeros
from tests.golden.constants import HEADER, PLACE, rows

#: Settings under which NumPy, BLAS and the C library choose other code: of this processor, of one with AVX2, and of one
#: without. NumPy renamed the features in version 2.4.
SETTINGS = [
    {},
    {
        "NPY_DISABLE_CPU_FEATURES": "X86_V4 AVX512_ICL AVX512_SKX AVX512F",
        "OPENBLAS_CORETYPE": "Haswell",
        "OPENBLAS_NUM_THREADS": "2",
    },
    {
        "NPY_DISABLE_CPU_FEATURES": "X86_V3 X86_V4 AVX512_ICL AVX512_SKX AVX512F AVX2 FMA3",
        "OPENBLAS_CORETYPE": "Prescott",
        "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA,-FMA4,-AVX2_Usable,-FMA_Usable",
    },
]


def test_constants_are_those_of_the_file() -> None:
    with PLACE.open(encoding="utf-8", newline="") as file:
        header, *kept = csv.reader(file)
    assert tuple(header) == HEADER
    for before, now in zip(kept, rows(), strict=True):
        assert tuple(before) == now


def test_exports_and_states_have_the_same_bytes_under_every_setting() -> None:
    command = [sys.executable, "-W", "ignore", "-m", "tests.golden.constants"]
    bare = {name: value for name, value in os.environ.items() if not any(name in one for one in SETTINGS)}
    running = [subprocess.Popen(command, env=bare | one, stdout=subprocess.PIPE, text=True) for one in SETTINGS]
    first, *others = [(one.communicate(timeout=1800)[0].splitlines(), one.returncode) for one in running]
    assert first[1] == 0
    assert len(first[0]) > 30
    for setting, other in zip(SETTINGS[1:], others, strict=True):
        assert other == first, setting


#: Functions, arguments and published digits of the results.
KNOWN = [
    (exp, 1.0, "2.718281828459045235360287471352662498"),
    (exp, -0.5, "0.606530659712633423603799534991180453"),
    (expm1, 1.0, "1.718281828459045235360287471352662498"),
    (log, 2.0, "0.693147180559945309417232121458176568"),
    (log, 10.0, "2.302585092994045684017991454684364208"),
    (tanh, 1.0, "0.761594155955764888119458282604793590"),
    (tanh, -0.5, "-0.462117157260009758502318483643672549"),
]


@pytest.mark.parametrize(("function", "x", "digits"), KNOWN)
def test_functions_are_the_nearest_doubles(function: object, x: float, digits: str) -> None:
    assert function(x) == float(Decimal(digits))  # type: ignore[operator]


def test_cosine_and_sine_follow_the_exact_values_of_a_circle() -> None:
    turns = np.array([0.0, 1 / 12, 0.125, 0.25, 1 / 3, 0.5, -0.25, 7.25])
    cosine, sine = cos_sin(turns)
    root = math.sqrt(3) / 2
    assert cosine == pytest.approx([1, root, math.sqrt(0.5), 0, -0.5, -1, 0, 0], abs=2e-15)
    assert sine == pytest.approx([0, 0.5, math.sqrt(0.5), 1, root, 0, -1, 1], abs=2e-15)


def test_zeros_of_a_sampled_chain_are_the_nearest_doubles() -> None:
    assert sampling_zeros(3) == [float(-2 - Decimal(3).sqrt()), float(-2 + Decimal(3).sqrt())]
    for degree in range(2, 9):
        zeros = sampling_zeros(degree)
        assert np.polyval(euler_frobenius(degree), zeros) == pytest.approx(0, abs=1e-4 * abs(zeros[0]) ** (degree - 2))
        assert (-1.0 in zeros) == (degree % 2 == 0)
