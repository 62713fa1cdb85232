"""Measure the CPU seconds of one `identify` with full judgement, by model and machine. The names are permanent."""

from __future__ import annotations

import resource
import time

import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from benchmarks.models import MANY, MODELS, SEEDS, identify_case, make_case
from pmfid import NotIdentifiableError


@pytest.mark.benchmark(timer=time.process_time)
@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("name", MODELS)
def test_identify_of_a_model(benchmark: BenchmarkFixture, name: str, seed: int) -> None:
    case = make_case(name, seed)
    try:
        result = benchmark.pedantic(identify_case, args=(case,), rounds=1)
    except NotIdentifiableError as error:
        benchmark.extra_info["refused"] = str(error)
        return
    benchmark.extra_info["method"] = result.estimator.method
    benchmark.extra_info["status"] = list(result.status)
    assert len(result.theta) == len(result.theta_std)


@pytest.mark.benchmark(timer=time.process_time)
@pytest.mark.parametrize("method", ["auto", "ls"])
def test_identify_of_a_million_samples(benchmark: BenchmarkFixture, method: str) -> None:
    case = make_case("plain", 0, MANY)
    result = benchmark.pedantic(identify_case, args=(case,), kwargs={"method": method}, rounds=1)
    benchmark.extra_info["status"] = list(result.status)
    benchmark.extra_info["peak"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss  # of the process [kB]
    assert len(result.theta) == len(result.theta_std)
