"""The parameters of an earlier identification in RESULT.json, validated on load.

Every value in the file must be a number, and the model must be the model of AXIS.toml.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import NoReturn

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from pmfid.errors import UsageError, printable
from pmfid.io.safety import MOST_BYTES
from pmfid.types import Floats

#: Largest number of letters of a text from a file in a message.
LONGEST_TEXT = 150
#: Relative difference below which a number in a file equals the configured number.
STORED_SAME = 1e-6

REMEDY = "give the result.json that `pmfid identify --out` writes, or what --json prints"
SAME_AXIS = "give the AXIS.toml of the identification"
#: Prefixes of names that are not parameters of the motion, such as unknowns of a pre-filter and an input gain. A
#: separate function checks the gain.
NOT_OF_MOTION = ("prefilter_", "input_gain")


class _Section(BaseModel):
    model_config = ConfigDict(frozen=True, extra="ignore", strict=True, allow_inf_nan=False)


class _Parameter(_Section):
    value: float
    std: float | None = None
    unit: str | None = None


class Stored(_Section):
    """Parameters and units in a file.

    `model` is the kind of the model, and `method` is the method of the estimate. The values of input_gain, dead_time
    [s] and equation were known before the estimate. A value is None if the file does not have it. `source` is the name
    of the file.
    """

    model: str
    parameters: dict[str, _Parameter] = Field(min_length=1)
    method: str = "given"
    input_gain: float | None = None
    dead_time: float | None = None
    equation: str | None = None
    source: str = ""

    def theta(self, kind: str, names: Sequence[str], units: Sequence[str]) -> Floats:
        """Return the parameters (p,) in the order of a model's names. Raises UsageError for parameters of another
        model.
        """
        if self.model != kind:
            self._refuse(f'the result has kind = "{self.model}", but [model] has kind = "{kind}"; {SAME_AXIS}')
        own = [name for name in self.parameters if name in names or not name.startswith(NOT_OF_MOTION)]
        missing = [name for name in names if name not in own]
        foreign = [name for name in own if name not in names]
        if missing or foreign:
            differences = [f"has no {', '.join(missing)}"] * bool(missing)
            differences += [f"has {', '.join(foreign)}"] * bool(foreign)
            self._refuse(f"the result {' and '.join(differences)}, but [model] has {', '.join(names)}; {SAME_AXIS}")
        for name, unit in zip(names, units, strict=True):
            if (stored := self.parameters[name].unit) not in (None, unit):
                self._refuse(f"{name} is in {stored!r} in the result, but in {unit!r} in [model]; {SAME_AXIS}")
        return np.array([self.parameters[name].value for name in names])

    def check_known(self, what: str, value: float) -> None:
        """Raise UsageError if `what`, "input_gain" or "dead_time", had another value in the identification."""
        then = self.input_gain if what == "input_gain" else self.dead_time
        if then is not None and not abs(then - value) <= STORED_SAME * max(abs(then), abs(value)):
            self._refuse(f"the result has {what} = {then:.9g}, but [model] has {value:.9g}; {SAME_AXIS}")

    def check_equation(self, text: str) -> None:
        """Raise UsageError for parameters of another equation.

        Parameter names do not show a known dead time, a friction term's speed or a force's pitch.
        """
        if self.equation is not None and self.equation != text:
            stored = printable(" ".join(self.equation.split()))[:LONGEST_TEXT]
            self._refuse(f"the result has {stored}, but [model] has {text}; {SAME_AXIS}")

    def _refuse(self, text: str) -> NoReturn:
        raise UsageError(f"{self.source}: {text}")


def read_stored(path: Path) -> Stored:
    """Read the parameters from the file at `path`. Raises UsageError with the first problem if the file is not a
    result.
    """
    try:
        if path.stat().st_size > MOST_BYTES:
            raise UsageError(f"{path}: the file has more than {MOST_BYTES} bytes, too many for a result; {REMEDY}")
        raw = json.loads(path.read_text(encoding="utf-8-sig"), parse_constant=_no_number)
        return Stored.model_validate(raw).model_copy(update={"source": str(path)})
    except OSError as error:
        raise UsageError(f"{path}: cannot read the result: {error.strerror}; {REMEDY}") from None
    except ValidationError as error:
        raise UsageError(f"{path}: {_first(error)}; {REMEDY}") from None
    except (ValueError, RecursionError, OverflowError) as error:
        raise UsageError(f"{path}: not a result in JSON: {' '.join(str(error).split())}; {REMEDY}") from None


def _no_number(text: str) -> NoReturn:
    raise ValueError(f"{text} is not a number")


def _first(error: ValidationError) -> str:
    problem = error.errors()[0]
    place = ".".join(str(part) for part in problem["loc"]) or "the file"
    if problem["type"] == "missing":
        return f"{place} is missing"
    return f"{place}: {problem['msg'].replace('Input should', 'it should')}"
