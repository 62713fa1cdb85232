"""Transfer functions: what is no estimate, and what to mind where there is one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pmfid.errors import NotIdentifiableError
from pmfid.estimators.base import Estimator
from pmfid.findings import Finding, make_notes
from pmfid.judge.assess import Assessment
from pmfid.transfer.experiment import Experiment
from pmfid.transfer.order import Search
from pmfid.transfer.process import Process

#: The input must not be correlated with the noise by more than chance for these to be consistent without reference.
FEEDBACK = (
    "the residual is correlated with later inputs, so the input has the noise in it, as a controller feeds it back: "
    "the estimate is biased; give the reference of the controller ([record] reference) to srivc, iv or output-error"
)
IGNORED = "{method} does not use the reference of the controller; srivc, iv and output-error do"
DEPENDENT = (
    "the input explains some of the residual: another dead time, more poles or zeros, or another hold may explain "
    "more; the standard errors leave out what this moves the estimate by"
)
REPEATS = (
    "the residual does the same in every period of the input: that is an error of the model, not noise, and the error "
    "bars allow for one like it; another structure may explain it"
)
OTHER_HOLD = (
    'with the other hold of the input the model follows the records better: hold = "zoh" is for one that a converter '
    'holds, "foh" for one that runs on between the samples; try the other, it moves the estimate'
)
UNKNOWN_HOLD = (
    "the record does not tell whether its input is held between the samples or runs on, and that moves a parameter "
    'beyond its standard error: make sure of [record] hold, "zoh" or "foh", or sample faster'
)
SURPLUS = (
    "one pole and one zero less explain the record as well: it does not tell where they are, and their standard errors "
    "mean nothing; use a smaller n and m"
)
MOVED = (
    "with the colour of the noise in mind the estimate is elsewhere, by more than its standard errors: it has taken "
    "some of the noise for dynamics; record longer, or use a smaller n and m"
)
UNKNOWN_POLE = "a pole is not known to half its size: record longer, excite it more, or use a smaller n and m"
#: Less of the output explained [%] is worth a sentence.
POOR_FIT = 10.0
#: An output further off than FAR robust standard deviations, in less than a part FEW of the samples, is an outlier.
FAR, FEW = 10.0, 0.01


def check_known(estimator: Estimator, theta: np.ndarray, cov: np.ndarray, checks: Assessment) -> None:
    """Raises NotIdentifiableError if the output does not depend on the input, whatever the standard errors are."""
    variance = np.diagonal(cov)
    if not (np.all(np.isfinite(theta)) and np.all(np.isfinite(cov)) and np.all(variance > 0)):
        raise NotIdentifiableError(
            f"the uncertainty of the transfer function is beyond numbers ({estimator.method}): the records do not "
            "identify it; excite the process more, or use fewer poles and zeros"
        )
    if not checks.depends:
        offset = "" if "offset" in estimator.names else "give offset = true in [model] where it has a constant, "
        raise NotIdentifiableError(
            f"the output hardly depends on the input ({estimator.method}): chance alone explains as much of it; "
            f"check the columns, the dead time and for outliers, {offset}excite the process more, or use fewer poles "
            "and zeros"
        )


def doubts(estimator: Estimator, theta: np.ndarray, std: np.ndarray, checks: Assessment) -> list[Finding]:
    """What there is to doubt in numbers that are there."""
    residual = np.concatenate(checks.residual)
    spread = 1.4826 * float(np.median(np.abs(residual - np.median(residual))))
    far = int(np.sum(np.abs(residual - np.median(residual)) > FAR * spread)) if spread > 0 else 0
    found = []
    unknown = [name for name, value, s in zip(estimator.names, theta, std, strict=True) if s > abs(value)]
    if unknown:
        found.append(f"not known to its own size: {', '.join(unknown)}; fewer poles or zeros may do")
    if 0 < far <= FEW * residual.size:
        found.append(f"{far} samples of the output are far off the others, and may decide everything: leave them empty")
    if 0 <= checks.fit < POOR_FIT:
        found.append(f"the model explains {checks.fit:.2g} % of the output, no more")
    if "offset" not in estimator.names and abs(np.mean(residual)) > 0.5 * np.std(residual):
        found.append("the residual has a mean: give offset = true in [model]")
    return make_notes("fit", found)


def findings_on(
    experiments: Sequence[Experiment], checks: Assessment, process: Process, flags: tuple[str, ...], expected: bool
) -> list[Finding]:
    """What the residual tests, the poles and the records give to mind. flags: what of it goes into the status, as
    `flags_on` has it; expected: poles in the right half-plane were asked for."""
    found = [
        Finding(code, sentence, severity="doubt" if code in flags else "note")
        for code, holds, sentence in _list_doubts(checks, process, flags, expected)
        if holds
    ]
    missing = sum(int(np.sum(~np.isfinite(experiment.y))) for experiment in experiments)
    return found + make_notes("missing", [f"{missing} samples of the output are missing"] * bool(missing))


def _list_doubts(
    checks: Assessment, process: Process, flags: tuple[str, ...], expected: bool
) -> tuple[tuple[str, bool, str], ...]:
    """Code, whether it is the case, and the sentence."""
    second, hold = checks.second, checks.hold
    unstable = bool(np.any(process.poles.real > 0)) and not expected
    return (
        ("feedback", "feedback" in flags, FEEDBACK),
        ("unmodelled", checks.unmodelled, DEPENDENT),
        ("unmodelled", checks.repeats, REPEATS),
        ("unmodelled", hold.better, OTHER_HOLD),
        ("model_spread", hold.hidden and not second.surplus, UNKNOWN_HOLD),
        ("uncertain", second.surplus, SURPLUS),
        ("uncertain", second.moved, MOVED),
        ("uncertain", "uncertain" in flags and not (second.surplus or second.moved), UNKNOWN_POLE),
        ("unstable", unstable, "the transfer function is unstable: what it simulates, and so the fit, says nothing"),
    )


def search_notes(search: Search) -> list[str]:
    """What to mind before the best structure is taken."""
    best, found = search.best, []
    if best.refused:
        found.append(f"identify has no estimate that it vouches for; the first one: {best.refused}")
    if not best.settled:
        found.append("no structure settled: the order is that of unfinished fits")
    if not best.white:
        found.append(
            "what the best structure leaves is not white noise, not even after the whitening filter: the "
            "criterion may then prefer too many poles and zeros; take the smallest structure that fits nearly as well"
        )
    if best.fit < POOR_FIT:
        found.append(f"the best structure explains {max(best.fit, 0.0):.2g} % of the output, no more: it may be chance")
    return found
