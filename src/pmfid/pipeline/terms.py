"""The search for the terms of a drive's equation, by the comparison of forces in the fit."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import cast

import numpy as np

from pmfid.config.axis import Axis
from pmfid.diagnostics.matter import sizes
from pmfid.errors import NotIdentifiableError, UsageError
from pmfid.estimators.motion_fit import MotionFit
from pmfid.findings import make_notes
from pmfid.fit.second_mass import SecondMass
from pmfid.fit.weighing import WeighedForce
from pmfid.models.axes import rotary
from pmfid.models.drive import Drive
from pmfid.models.equation import ESTIMATE
from pmfid.pipeline.drives import match_kind
from pmfid.pipeline.fitted import SecondMassError
from pmfid.pipeline.identify import identify
from pmfid.pipeline.known import check_numbers_known
from pmfid.pipeline.result import DriveResult
from pmfid.presentation import Presentable, Summary, plain_dict, remarks_of
from pmfid.records.record import Record
from pmfid.units import Quantity, quantity

#: Keys of [model] with a period of the position.
PERIODS = ("cogging", "friction_period", "gravity")


def format_terms(added: Mapping[str, object]) -> str:
    """Return the terms of [model] as words."""
    named = {key: value for key, value in added.items() if value is not False}
    return ", ".join(
        f"{value} {key}" if isinstance(value, str) and value != ESTIMATE else key for key, value in named.items()
    )


def write_line(key: str, value: object) -> str:
    """Return a line of [model] in which a number with a unit has its own."""
    if isinstance(value, bool):
        return f"{key} = {str(value).lower()}"
    if isinstance(value, Quantity):
        return f'{key} = "{float(value) / value.unit.factor:.9g} {value.unit.name}"'
    if isinstance(value, float):
        return f"{key} = {value:.9g}"
    return f'{key} = "{value}"'


@dataclass(frozen=True)
class TermRow:
    """A force of the comparison.

    `words` name it, and `remedy` says what to do. `added` holds the keys of [model] that express it. `chosen` says
    whether the fit has the force. `log_odds` is the logarithm of its posterior odds. `values` holds value, standard
    error and unit of each size. `moved` is the change of each parameter by the force, relative to the parameter or to
    its larger standard error.
    """

    words: str
    remedy: str
    added: dict[str, object]
    chosen: bool
    log_odds: float
    values: tuple[tuple[float, float, str], ...]
    moved: dict[str, float]

    @property
    def largest_change(self) -> str:
        """The parameter that the force moves most, with its change."""
        name, part = max(self.moved.items(), key=lambda pair: abs(pair[1]), default=("", 0.0))
        return name and f"{name} {100 * part:+.2g} %"

    def to_json(self) -> dict[str, object]:
        """Return the object of the row. A number that is not finite becomes None."""
        values = [{"value": value, "std": std, "unit": unit} for value, std, unit in self.values]
        own = {"term": self.words, "set": self.added, "remedy": self.remedy, "chosen": self.chosen}
        return plain_dict(own | {"log_odds": self.log_odds, "values": values, "moved": self.moved})


def _keys_of(force: WeighedForce) -> dict[str, object]:
    """Return the keys of [model] that a force sets, with a period in its unit."""
    return {key: quantity(value) for key, value in force.candidates[0].change.items()}


def make_row(force: WeighedForce, result: DriveResult) -> TermRow:
    """Return the row of a force in the fit of a result."""
    turns, names = result.estimator.model.equation.motion.travel == "rad", result.names
    first = force.candidates[0]
    units = [rotary(one.unit) if turns else one.unit for one in force.candidates]
    scale = np.fmax(sizes(result.estimator, result.theta), result.theta_std)
    return TermRow(
        first.words,
        first.remedy,
        _keys_of(force),
        force.chosen,
        force.odds,
        tuple(zip(force.sizes.tolist(), force.stds.tolist(), units, strict=True)),
        dict(zip(names, (force.moved / scale).tolist(), strict=True)),
    )


def make_second_row(second: SecondMass, axis: Axis) -> TermRow:
    """Return the row of a second mass, with its resonance or its gap."""
    unit = axis.model.make().equation.motion.travel
    sizes = ((second.resonance, math.nan, "Hz"),) if second.resonance is not None else ()
    if second.play is not None:
        sizes = ((*second.play, unit),)
    words = second.describe(unit).removesuffix(",")
    return TermRow(words, second.remedy, second.change, True, second.odds, sizes, {})


@dataclass(frozen=True, eq=False, repr=False)
class TermSearch(Presentable):
    """The result of a search for terms.

    Attributes
    ----------
    name : str
        Name of the record.
    samples : int
    first : DriveResult
        The result with the given model.
    result : DriveResult
        The result with the recommended model.
    added : dict
        The keys of [model] that the search sets, with their values.
    rows : tuple of TermRow
        All forces that the search compared, the chosen ones first.

    Examples
    --------
    >>> import numpy as np
    >>> from pmfid import Drive, Encoder, quantize, search_terms
    >>> from pmfid.simulation import CART, CART_DT, CART_RESOLUTION, prbs, simulate_drive
    >>> u = prbs(600, clock=10, amplitude=4.0, rng=np.random.default_rng(1))
    >>> counts = quantize(simulate_drive(CART, u, CART_DT).x, CART_RESOLUTION)
    >>> settings = {"model": Drive(CART.input_gain), "dt": CART_DT, "encoder": Encoder(CART_RESOLUTION)}
    >>> search_terms(u, counts, **settings).sentence
    'The record asks for no further term of [model].'
    """

    first: DriveResult
    result: DriveResult
    added: dict[str, object]
    rows: tuple[TermRow, ...]

    @property
    def name(self) -> str:
        return self.result.name

    @property
    def samples(self) -> int:
        return self.result.samples

    @property
    def model(self) -> Drive:
        """The recommended model."""
        return cast(Drive, self.result.estimator.model)

    @property
    def status(self) -> tuple[str, ...]:
        """The status of the result with the recommended model."""
        return self.result.status

    @property
    def notes(self) -> tuple[str, ...]:
        """The notes on the result with the recommended model."""
        return self.result.notes

    @cached_property
    def lines(self) -> tuple[str, ...]:
        """The lines of [model] for AXIS.toml."""
        values = [(field.name, getattr(self.model, field.name), field.default) for field in fields(Drive)]
        return (
            "[model]",
            'kind = "drive"',
            *(write_line(key, value) for key, value, usual in values if value != usual),
        )

    @property
    def sentence(self) -> str:
        """The summary of the search in one sentence."""
        if not self.added:
            return "The record asks for no further term of [model]."
        name, part = max(self.moved.items(), key=lambda pair: abs(pair[1]))
        return f"The record asks for {format_terms(self.added)}, without which {name} is {100 * abs(part):.2g} % off."

    @property
    def moved(self) -> dict[str, float]:
        """The relative change of each parameter of the given model from the first to the recommended model."""
        names = [name for name in self.first.names if name in self.result.names]
        return {name: float(self.first[name] / self.result[name] - 1) for name in names}

    def to_dict(self) -> dict[str, object]:
        """Return the object that `--json` prints."""
        return plain_dict(
            {
                "record": self.name,
                "model": self.lines,
                "added": self.added,
                "sentence": self.sentence,
                "terms": [row.to_json() for row in self.rows],
                "result": self.result.to_dict(),
                "status": self.status,
                "notes": self.notes,
            }
        )

    def summary(self) -> Summary:
        header, rows = term_rows([row for row in self.rows if row.chosen])
        own = self.result.summary()
        title = f"{self.name}, {self.samples} samples. {self.sentence}"
        lines = [*(f"{row[0]}: {row[2]}" for row in rows), *own.lines]
        return Summary(title, header, rows, lines, remarks_of(self.status, self.notes))

    def columns(self) -> dict[str, object]:
        """The columns of a table with one row for each size of each force."""
        rows = [(row.words, row.chosen, row.log_odds, *value) for row in self.rows for value in row.values]
        names = ("term", "chosen", "log_odds", "value", "std", "unit")
        return dict(zip(names, map(list, zip(*rows, strict=True)), strict=True))


def term_rows(rows: Sequence[TermRow]) -> tuple[list[str], list[list[str]]]:
    """Return the header and a row of text for each force of a comparison."""
    return ["term", "log odds", "size", "largest change", "remedy"], [
        [
            row.words,
            f"{row.log_odds:+.3g}",
            ", ".join(f"{value:.3g} ± {std:.2g} {unit}" for value, std, unit in row.values),
            row.largest_change,
            row.remedy,
        ]
        for row in rows
    ]


def search_drive(data: Record, axis: Axis) -> TermSearch:
    """Search the terms of a drive that a record asks for and [model] does not have.

    The fit compares all forces of its table. The model gets the chosen ones that [model] can express, and is fitted
    again, until the fit chooses none of them. Raises UsageError if the plant is not a drive, and NotIdentifiableError
    if the record cannot identify the given model.
    """
    axis = match_kind(data, axis)
    model = axis.model.make()
    if not isinstance(model, Drive):
        raise UsageError(
            f'a search for terms needs kind = "drive", got "{axis.model.kind}"; set kind = "drive", or '
            '"transfer_function" to search for poles and zeros'
        )
    check_numbers_known(axis, "pmfid terms")
    fitted = axis.estimator.model_copy(update={"method": MotionFit.method, "forgetting": 1.0, "cutoff": None})
    axis = axis.model_copy(update={"estimator": fitted})
    added, rows = dict[str, object](), list[TermRow]()
    try:
        first = result = cast(DriveResult, identify(data, axis))
    except SecondMassError as error:  # one mass follows nothing that further terms could mend
        added, rows = error.second.change, [make_second_row(error.second, axis)]
        axis = axis.model_copy(update={"model": axis.model.model_copy(update=added)})
        first = result = cast(DriveResult, identify(data, axis))
    while further := recommend(cast(Drive, result.estimator.model), result.forces, added, result.second):
        longer = axis.model_copy(update={"model": axis.model.model_copy(update={**added, **further})})
        try:
            better = cast(DriveResult, identify(data, longer))
        except NotIdentifiableError as error:
            note = f"the record cannot identify a model with {format_terms(further)}, because {error}"
            result = result.with_findings(*make_notes("terms", [note]))
            break
        rows += [row for row in _rows_of(result) if row.chosen and row.added]
        rows += [] if result.second is None else [make_second_row(result.second, axis)]
        result, added = better, {**added, **further}
    rows += _rows_of(result)
    return TermSearch(first, result, added, tuple(sorted(rows, key=lambda row: not row.chosen)))


def _rows_of(result: DriveResult) -> list[TermRow]:
    return [make_row(force, result) for force in result.forces]


def recommend(
    model: Drive, forces: Sequence[WeighedForce], added: Mapping[str, object], second: SecondMass | None = None
) -> dict[str, object]:
    """Return the keys of [model] that express the chosen forces with odds above 1, without those in `added`.

    A model has one period of each kind. Directional friction contains the load, and a spring has a load of its own. A
    second mass stands for the forces that were chosen without it.
    """
    if second is not None:
        return second.change
    further: dict[str, object] = {}
    for force in sorted(forces, key=lambda force: force.odds):
        if force.chosen and force.odds > 0:
            further |= _keys_of(force)
    if "directional" in (further.get("friction"), model.friction):
        further |= {"offset": False} if model.offset else {}
        further = {key: value for key, value in further.items() if key != "offset" or value is False}
    elif further.get("spring"):
        further.pop("offset", None)
    has = {key for key in PERIODS if getattr(model, key)}
    return {key: value for key, value in further.items() if key not in added and key not in has}
