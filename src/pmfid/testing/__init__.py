"""Checks of the contract that every estimator keeps.

    from pmfid.testing import check_estimator

    check_estimator(MyEstimator(pmfid.Drive(2.0), pmfid.Encoder(1e-5), dt=0.01, cutoff=30.0))

An estimator over whole records has `fit(u, counts)`. An estimator that runs sample by sample has `step`, `run` and the
other methods of `RecursiveEstimator`. The shortest way is a frozen dataclass derived from `BatchEstimator` or
`RecursiveEstimator`. These classes provide configuration, columns, copies and saved states. The checks also run one by
one:

    import pytest
    from pmfid.testing import checks_of

    @pytest.mark.parametrize(("name", "check"), checks_of(estimator))
    def test_my_estimator(name, check):
        check()

The record is simulated from the estimator's own model, and the encoder resolves its motion well. An equation that
pmfid cannot simulate needs a record from the caller.
"""

from pmfid.testing.case import ContractError
from pmfid.testing.contract import check_estimator, checks_of

__all__ = ["ContractError", "check_estimator", "checks_of"]
