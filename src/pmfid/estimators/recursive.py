"""Recursive estimators: one sample in, one estimate out."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from numbers import Real
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pmfid.errors import UsageError, place_of
from pmfid.estimators.base import Estimator, check_arrays, integer_counts
from pmfid.estimators.encoder_noise import shown
from pmfid.layout.structures import constants_of
from pmfid.status import Status

if TYPE_CHECKING:
    from pmfid.estimators.fleet import Tracks


@dataclass(frozen=True)
class Track:
    """Estimates over a record of n samples with p parameters.

    theta: (n, p); innovation: (n,) a priori error in the unit of the target; innovation_variance: (n,);
    variance_factor: (n, p), the diagonal of P; inflation: (n, p), what coloured innovations make of the variances,
    0 while not known; status: (n,) `Status` bits; names, units: of the p parameters.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    theta: NDArray[np.float64]
    variance_factor: NDArray[np.float64]
    inflation: NDArray[np.float64]
    innovation: NDArray[np.float64]
    innovation_variance: NDArray[np.float64]
    status: NDArray[np.uint32]

    @cached_property
    def theta_std(self) -> NDArray[np.float64]:
        """(n, p) standard deviations, infinite until there is an estimate; scaled by the inflation once it is known."""
        known = self.innovation_variance > 0
        scale = np.where(self.inflation[known] > 0, self.inflation[known], 1.0)
        std = np.full_like(self.theta, np.inf)
        with np.errstate(over="ignore"):  # infinite is right where nothing is known
            std[known] = np.sqrt(self.variance_factor[known] * self.innovation_variance[known, None] * scale)
        return std

    def __getitem__(self, name: str) -> NDArray[np.float64]:
        """The (n,) track of one parameter. Raises UnknownParameterError, a KeyError, listing the names."""
        return self.theta[..., place_of(name, self.names)]

    def flagged(self, bit: Status) -> NDArray[np.bool_]:
        """(n,) where a status bit is set."""
        return np.asarray((self.status & bit) != 0)


#: What becomes of old samples -> its number in the kernel.
FORGETTING_SCHEMES = {
    name: constants_of(None)[f"PMF_{name.upper().replace('-', '_')}"]
    for name in ("exponential", "directional", "constant-trace", "window")
}
#: The same of `forgetting_of`, which is a scheme of its own there.
SEPARATE = constants_of(None)["PMF_SEPARATE"]
#: Information that is never forgotten under constant trace, as a part of the largest seen.
TRACE_REGULARIZATION = 1e-6
#: What is known from larger motions than those of late is forgotten so many times as fast.
HASTE = 8
#: The kernel looks at the size of the motion every so many samples.
LOOK = constants_of(None)["PMF_LOOK"]
#: The sliding window drops one of its 8 blocks at a time: it holds 7 to 8 of them.
WINDOW_BLOCKS = 7.5


@dataclass(frozen=True)
class RecursiveEstimator(Estimator):
    """An `Estimator` that runs sample by sample.

    forgetting: weight of the past per sample, 0 < forgetting <= 1; the memory is dt / (1 - forgetting). With 1 float64
    forgets nothing; a sum of float32 would take in no more after some millions of samples, so there what was gathered
    counts by half whenever it is 2^19 samples.
    forgetting_scheme, none of which winds up without excitation:
    "exponential": every sample is forgotten alike; a small part of the largest information is never forgotten, and
    theta is held where that is all there is (Levenberg-Marquardt, Ljung and Soderstrom 1983);
    "directional": only in the directions that the samples excite (Cao and Schwartz 2000); least squares only. Nothing
    is lost at rest or at constant speed, however long, but to the noise of a coarse encoder, which excites, too. The
    memory of an excited direction is longer, by about the number of parameters;
    "constant-trace": as much as keeps the mean of P, each entry relative to its value after the first memory, and at
    most twice as fast as `forgetting` (Goodwin and Sin 1984, section 3.3);
    "window": the samples of the last memory alike, older ones not at all, in blocks of an eighth.
    forgetting_of: factors of single parameters, by name, that change more slowly than the others or never (1):
    {"b0": 1.0}. With the exponential scheme only; a parameter that is known to stay sharpens the others.
    The object holds one state; `step` and `run` continue from it, `reset` goes back to the start.
    """

    forgetting: float = field(default=1.0, kw_only=True)
    forgetting_scheme: str = field(default="exponential", kw_only=True)
    forgetting_of: Mapping[str, float] | None = field(default=None, kw_only=True)
    _kernel: Any = field(default=None, init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not isinstance(self.forgetting, Real) or not 0 < self.forgetting <= 1:
            raise UsageError(
                f"forgetting must be in (0, 1], got {self.forgetting!r}; for a memory of T seconds use 1 - dt/T"
            )
        self._check_scheme()
        self._check_room()
        try:
            object.__setattr__(self, "_kernel", self.make_kernel(self.forgetting))
        except ValueError as error:  # more than it holds
            raise UsageError(str(error)) from None
        self._kernel.names = self.names
        # bound here so that a call costs no look-up in Python
        object.__setattr__(self, "step", self._kernel.step)

    def _check_scheme(self) -> None:
        scheme = self.forgetting_scheme
        if scheme not in FORGETTING_SCHEMES:
            raise UsageError(f"forgetting_scheme must be one of {sorted(FORGETTING_SCHEMES)}, got {scheme!r}")
        if scheme == "directional" and not self.plain:
            raise UsageError(
                f"directional forgetting is for rls, not for {self.method}, whose instruments point elsewhere; "
                "use constant-trace or window"
            )
        for name, factor in (self.forgetting_of or {}).items():
            if name not in self.names or not self.forgetting <= factor <= 1:
                raise UsageError(
                    f"forgetting_of takes factors from forgetting = {self.forgetting} to 1 of {list(self.names)}, got "
                    f"{factor} of {name!r}"
                )
        if self.forgetting_of and scheme != "exponential":
            raise UsageError(f"forgetting_of is for the exponential scheme, not for {scheme}")

    def _check_room(self) -> None:
        most, model = self.kernel_class.max_parameters, self.model
        if len(self.names) > most:
            cure = "poles (n), zeros (m) or extras" if self.equation.process else "unknown terms"
            other = ", or srivc on whole records" if self.equation.process else ""
            raise UsageError(
                f"{self.method} estimates at most {most} parameters, this {model.kind} has {len(self.names)}: "
                f"{', '.join(self.names)}; use fewer {cure}{other}"
            )

    def recursion_config(
        self, parameters: int, instrumental: bool, forgetting: float, first_column: int = 0
    ) -> dict[str, Any]:
        config = super().recursion_config(parameters, instrumental, forgetting, first_column)
        scheme = self.forgetting_scheme if forgetting < 1 else "exponential"
        config["scheme"] = FORGETTING_SCHEMES[scheme]
        if forgetting < 1 and not self.equation.process:
            config["half_memory"] = math.ceil(0.5 / (1 - forgetting) / LOOK)
            config["haste"], config["leak"] = forgetting**HASTE, forgetting ** (HASTE * LOOK)
            config["leading"], config["shown"] = self.equation.leading, shown(self)
            directions = parameters if scheme == "directional" else 1
            config["forgetting"] = forgetting**directions  # one direction at a time: only so all have the same memory
            config["outgrown"] = directions / (1 - config["forgetting"])
        if self.forgetting_of and forgetting < 1:  # as with directional forgetting: innovations only
            config["residual_updates"] = 0
            config["scheme"] = SEPARATE
            config["keep"] = [math.sqrt(self.forgetting_of.get(name, forgetting)) for name in self.names]
        if scheme == "directional":  # the accumulated right-hand side does not follow the forgetting: innovations only
            config["residual_updates"] = 0
        if scheme == "constant-trace":  # bounds P by itself, but for a direction that others outgrow by far
            config["regularization"] = TRACE_REGULARIZATION
        if scheme == "window":
            config["residual_updates"] = 2**32 - 1
            config["window_block"] = math.ceil(1 / (1 - forgetting) / WINDOW_BLOCKS)
        return config

    def step(self, u: float, counts: int) -> Any:
        """One sample: the input applied from now on, the count read now. Returns an `Estimate`.

        The estimate has theta (p,), theta_cov (p, p), theta_std (p,), innovation, innovation_variance and status.
        A value that is not finite is flagged in the status and never enters.
        """
        return self._kernel.step(u, counts)

    def run(self, u: ArrayLike, counts: ArrayLike) -> Track:
        """Many samples at once, from the present state; u, counts: (n,). The same bits as `step` in a loop.

        Raises UsageError where the arrays differ in length or the counts are no integers.
        """
        return Track(self.names, self.units, *self._kernel.run(*check_arrays(u, counts)))

    def run_many(self, u: ArrayLike, counts: ArrayLike, *, every: int | None = None) -> Tracks:
        """Many axes at once, each from the present state of this estimator, which itself does not change.

        u: (axes, n), or (n,) the same for all; counts: (axes, n). The result has the last estimate of each axis, or
        every so many. Each axis has the bits of `run`. To go on with further samples use a `Fleet`.
        Raises UsageError like `Fleet.run`.
        """
        from pmfid.estimators.fleet import Fleet

        table = integer_counts(counts)
        return Fleet(self, max(1, table.shape[0]) if table.ndim else 1).run(u, table, every=every)

    @property
    def estimate(self) -> Any:
        """The present `Estimate`."""
        return self._kernel.estimate()

    def open_memory(self, keep: float, parameter: str | None = None) -> None:
        """After a change of the plant: only the part `keep` in (0, 1] of what was gathered counts from now on.

        parameter: what changed; what is known of the others for a given value of it stays. None: all. The estimate
        stays where it is and its variance grows (covariance reset, Goodwin and Sin 1984, in information form); filters
        and auxiliary model go on. Raises UsageError for another keep or an unknown parameter.
        """
        if not isinstance(keep, Real) or not 0 < keep <= 1:
            raise UsageError(f"keep must be in (0, 1], got {keep!r}; 0.001 lets new samples prevail at once")
        if parameter is not None and parameter not in self.names:
            raise UsageError(f"parameter must be one of {list(self.names)} or None, got {parameter!r}")
        self._kernel.open(keep, -1 if parameter is None else self.names.index(parameter))

    def rebase(self, counts: int) -> None:
        """The counter was set anew, as in a homing: it would have read `counts` at the last sample.

        What was known stays. Without this call the jump is found, flagged, and the motion in its sample lost, where it
        is larger than what the axis itself may do (`Encoder.guard`).
        """
        self._kernel.rebase(counts)

    def reset(self) -> None:
        """Forgets all samples."""
        self._kernel.reset()

    def get_state(self) -> bytes:
        """The whole state, with a version and checksums; `set_state` of an estimator with the same configuration, or
        the firmware exported from it, continues from it."""
        from pmfid.layout.saved import save_state

        return save_state(self._kernel, self.precision)

    def set_state(self, state: bytes) -> None:
        """Continues from a saved state. Raises UsageError, and stays as it was, for one of another configuration, a
        damaged one, and numbers that no sample could have made, whatever their checksum."""
        from pmfid.layout.saved import load_state

        load_state(self._kernel, self.precision, state)
