"""What an estimator owes those who use it, as checks that any estimator can be held to.

    from pmfid.testing import check_estimator

    check_estimator(MyEstimator(pmfid.Drive(2.0), pmfid.Encoder(1e-5), dt=0.01, cutoff=30.0))

An estimator over whole records has `fit(u, counts)`; one that runs sample by sample has `step`, `run` and the rest of
`RecursiveEstimator`. The least work is a frozen dataclass below `BatchEstimator` or `RecursiveEstimator`, which brings
configuration, columns, copies and saved states along. The checks also run one by one:

    import pytest
    from pmfid.testing import checks_of

    @pytest.mark.parametrize(("name", "check"), checks_of(estimator))
    def test_my_estimator(name, check):
        check()

The record is simulated from the estimator's own model, with motion that its encoder shows well; an equation that
nothing can simulate needs one of its own.
"""

from pmfid.testing.case import ContractError
from pmfid.testing.contract import check_estimator, checks_of

__all__ = ["ContractError", "check_estimator", "checks_of"]
