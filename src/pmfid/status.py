"""Status bits of an estimate, as the kernel defines them, each with an advice for the user."""

from __future__ import annotations

from enum import IntFlag

from pmfid.findings import Finding
from pmfid.kernel.structures import constants_of

_BITS = constants_of(None)


class Status(IntFlag):
    """Bits of `Estimate.status` and `Track.status`. The file csrc/pmf.h defines the value of each bit.

    Examples
    --------
    >>> from pmfid import Status
    >>> status = Status.STARTING | Status.SETTLING
    >>> int(status), Status.COUNT_JUMP in status
    (3, False)
    """

    STARTING = _BITS["PMF_STARTING"]
    SETTLING = _BITS["PMF_SETTLING"]
    POOR_EXCITATION = _BITS["PMF_POOR_EXCITATION"]
    COMPENSATION_HELD = _BITS["PMF_COMPENSATION_HELD"]
    INVALID_INPUT = _BITS["PMF_INVALID_INPUT"]
    COUNT_JUMP = _BITS["PMF_COUNT_JUMP"]
    STANDSTILL = _BITS["PMF_STANDSTILL"]
    RESET = _BITS["PMF_RESET"]
    FALLBACK = _BITS["PMF_FALLBACK"]
    UNMODELLED = _BITS["PMF_UNMODELLED"]
    FEEDBACK = _BITS["PMF_FEEDBACK"]
    DEAD_TIME = _BITS["PMF_DEAD_TIME"]
    #: Each of the following three names covers several bits. With NOT_AN_ESTIMATE, theta is no estimate or no new one.
    #: With SAMPLE_REJECTED, the sample was left out. With DISTORTED, the covariance is too small.
    NOT_AN_ESTIMATE = _BITS["PMF_NOT_AN_ESTIMATE"]
    SAMPLE_REJECTED = _BITS["PMF_SAMPLE_REJECTED"]
    DISTORTED = _BITS["PMF_DISTORTED"]

    @property
    def advice(self) -> tuple[str, ...]:
        """One sentence of advice for each bit that is set."""
        return tuple(ADVICE[bit] for bit in Status if bit in self)


#: The texts of each bit: the state, the remedy, and a detail that only `pmfid explain` and the report show.
_WORDS: dict[Status, tuple[str, str, str]] = {
    Status.STARTING: ("no estimate yet", "wait for motion that excites every parameter", ""),
    Status.SETTLING: (
        "the filters still contain their start values or a gap, so these samples are not used yet",
        "",
        "",
    ),
    Status.POOR_EXCITATION: (
        "the motion within the memory says too little about some parameter",
        "move the axis more, or use a longer memory",
        "",
    ),
    Status.COMPENSATION_HELD: (
        "the pre-filtered input varies too little to compensate the bias, so the last compensation is kept",
        "try other prefilter_zeros",
        "",
    ),
    Status.INVALID_INPUT: (
        "an input was not finite, or far beyond all others, and was left out",
        "check what writes the input",
        "The previous input is used instead, unless the counts respond to the new input or the new "
        "input stays. With edge times, the word also marks counts that changed without a valid age "
        "of the edge. Such an edge is used without its instant.",
    ),
    Status.COUNT_JUMP: (
        "no motion explains a jump of the counts, or the jump exceeds max_speed; the sample was left out",
        "check the wiring and the counter's bits",
        "A counter that was set to another value jumps as well, and needs no remedy.",
    ),
    Status.STANDSTILL: ("the counts did not change within standstill_time, so the axis is treated as at rest", "", ""),
    Status.RESET: ("a number exceeded the range of its format, so the estimator started again", "", ""),
    Status.FALLBACK: (
        "the simulated motion does not follow the plant, so the estimate comes from the simpler method",
        "",
        "",
    ),
    Status.UNMODELLED: (
        "the error of the equation is larger than the encoder's step explains",
        "search for the missing term with pmfid terms",
        "Causes are unmodelled friction, load or delay, a parameter that changes, or samples in bursts. No error "
        "bar covers this error.",
    ),
    Status.FEEDBACK: (
        "the input depends on the residual of the equation, as it does under position control",
        "record an open-loop motion, which is free of this bias",
        "A bias beyond the error bars is possible, and grows with the step of the encoder.",
    ),
    Status.DEAD_TIME: (
        "the plant moves later than the model",
        'set dead_time = "estimate"',
        "The input acts late, or friction at low speed differs from the model; the error bars do not cover this. "
        "Steps in open loop show the dead time best. For riv, estimate it with fit or iv, and give its value.",
    ),
}
_FINDINGS = {
    bit: Finding(str(bit.name).lower(), sentence, remedy, detail=detail)
    for bit, (sentence, remedy, detail) in _WORDS.items()
}
ADVICE = {
    bit: f"{finding.text}. {finding.detail}".rstrip(". ") if finding.detail else finding.text
    for bit, finding in _FINDINGS.items()
}


def status_findings(status: int) -> list[Finding]:
    """Return the finding of each bit that is set."""
    return [_FINDINGS[bit] for bit in Status if bit & status]


def status_names(status: int) -> list[str]:
    """Return the name of each bit that is set."""
    return [bit.name.lower() for bit in Status(status) if bit.name]
