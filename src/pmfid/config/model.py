"""[model] of AXIS.toml: a drive, a transfer function, or an equation with user-defined terms.

The description of a field ends the error message about the field. Therefore a description must be a sensible text after
"give ...".
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields
from typing import Annotated, Literal, Self, cast

from pydantic import AfterValidator, Field, PrivateAttr, WrapValidator, model_validator

from pmfid.config.keys import Form, KindName
from pmfid.config.toml_file import FileSection
from pmfid.errors import UsageError
from pmfid.models.axes import AxisKind
from pmfid.models.drive import Body, Drive, EquationModel, Friction, Model, Side
from pmfid.models.equation import Equation, Term
from pmfid.models.shapes import Along, Shape, Square, Stribeck, Wave
from pmfid.models.signals import Signal
from pmfid.models.transfer_function import TransferFunction
from pmfid.units import gain, keep_unit, quantity

#: Model classes by kind, without the kind of user-defined terms.
MODELS: dict[str, type[Drive | TransferFunction]] = {cls.kind: cls for cls in (Drive, TransferFunction)}
#: Fields of a model that no file sets, because the starts of experiments are always part of the fit.
NOT_IN_FILES = ("initial_conditions",)
#: Forms of forces by their names in files.
SHAPES: dict[str, Callable[..., Shape]] = {"stribeck": Stribeck, "square": Square, "wave": Wave, "along": Along}
Positive = Annotated[float, Field(gt=0)]


_TRAVEL = WrapValidator(lambda value, check: keep_unit(value, check, quantity))
_GAIN = WrapValidator(lambda value, check: keep_unit(value, check, gain))
#: A length, an angle or a speed, as a number in SI or as text with a unit.
Travel = Annotated[float, Field(gt=0), _TRAVEL]
Name = Annotated[str, Field(min_length=1)]


def _usable_gain(value: float | Literal["estimate"]) -> float | Literal["estimate"]:
    try:
        return Drive(value).input_gain  # Python and TOML have the same rule
    except UsageError as error:
        raise ValueError(str(error).partition(";")[0]) from None


#: A force per unit of input, as a number in SI, as text with a unit, or as "estimate".
Gain = Annotated[
    Literal["estimate"] | float,
    AfterValidator(_usable_gain),
    _GAIN,
]
FORMS = '"stribeck" with speed, "square", "wave" with period, or "along" with start, step and values'


class ShapeConfig(FileSection):
    """The form of a friction, or of a force that depends on the position, for a term of a user-defined equation."""

    form: Form = Field(description=FORMS)
    speed: Positive | Literal["estimate"] | None = Field(
        None, description='the speed of "stribeck" in the unit of y per s, or "estimate"'
    )
    period: Positive | None = Field(None, description='the period of "wave" in the unit of y')
    cosine: bool | None = Field(None, description='true if "wave" is a cosine, false if it is a sine')
    start: float | None = Field(None, description='the first position of "along" in the unit of y')
    step: Positive | None = Field(None, description='the distance between the positions of "along" in the unit of y')
    values: tuple[float, ...] | None = Field(None, strict=False, description='the force at each position of "along"')

    def make(self) -> Shape:
        """Return the shape of this section. Raises UsageError for keys that do not belong to the form."""
        given = {key: value for key, value in dict(self).items() if key != "form" and value is not None}
        try:
            return SHAPES[self.form](**given)
        except TypeError:
            raise UsageError(f"a shape has the form {FORMS}; got {self.form} with {list(given)}") from None


SIGNAL = 'the signal of the term: "input", "output", "direction", "constant", or one for friction or position'
DERIVATIVE = "which derivative of the signal, 0 for the signal itself"


class UnknownTerm(FileSection):
    """A term of a user-defined equation with an unknown coefficient."""

    signal: Signal = Field(description=SIGNAL)
    derivative: int = Field(0, description=DERIVATIVE)
    coefficient: float = Field(1.0, description="a known factor of the term, in addition to the unknown parameter")
    name: Name = Field(description='the name of the parameter, such as "inertia"')
    unit: str = Field("", description='the unit of the parameter, such as "kg m2"')
    shape: ShapeConfig | None = Field(None, description="the form of friction or of a force along the travel")


class KnownTerm(FileSection):
    """A term of a user-defined equation with a known coefficient."""

    signal: Signal = Field("input", description=SIGNAL)
    derivative: int = Field(0, description=DERIVATIVE)
    coefficient: float = Field(1.0, description="the known factor of the term")


class ModelConfig(FileSection):
    """[model]: the equation mass x'' + viscous_friction x' + coulomb_friction sign(x') [+ ...] = input_gain u.

    With kind = "equation", the section describes user-defined terms.
    """

    kind: KindName = Field(
        "drive", description='"drive", "transfer_function", or "equation" for the terms in unknown and known'
    )
    n: int | None = Field(None, description="the number of poles, 1 to 6, of a transfer function")
    m: int | None = Field(None, description="the number of zeros, 0 to n, of a transfer function")
    delay: int = Field(0, description="the dead time in whole samples, 0 to 20, of a transfer function")
    dead_time: float | Literal["estimate"] = Field(
        0.0, description='the dead time of the input in s, which need not be a multiple of dt, or "estimate"'
    )
    lag: float | Literal["estimate"] = Field(
        0.0, description='the time constant in s of a first-order lag of the input, or "estimate"'
    )
    integrators: int = Field(0, description="how many of the n poles of a transfer function are known to be at 0")
    unstable: bool = Field(
        False, description="true if a controller stabilises a transfer function with poles in the right half-plane"
    )
    axis: AxisKind = Field("linear", description='"linear" or "rotary", or drop the key if units determine the axis')
    input_gain: (
        Annotated[
            Literal["estimate"] | float,
            AfterValidator(_usable_gain),
            _GAIN,
        ]
        | None
    ) = Field(
        None,
        description='the force in N per unit of u, for example 2.0 or "0.35 N m/A", negative if u > 0 pushes backward, '
        'or "estimate"',
    )
    body: Body = Field("rigid", description='"rigid", or "two-mass" for a load on a spring')
    play: bool = Field(False, description="true for a gap between motor and load of a two-mass body, false for none")
    output: Side = Field(
        "motor", description='the mass of a two-mass body that the encoder shows: "motor", or "load" for the other one'
    )
    friction: Friction = Field("symmetric", description="whether friction differs between forward and backward")
    offset: bool = Field(False, description="true to identify a constant load as well, false if there is none")
    spring: bool = Field(False, description="true if the load hangs on a spring, false if there is none")
    stribeck: Annotated[Positive | Literal["estimate"], _TRAVEL] | None = Field(
        None, description='the speed up to which friction falls, in the unit of y per s, or "estimate"'
    )
    quadratic: bool = Field(False, description="true if friction grows with the square of the speed as well")
    gravity: Annotated[bool | Positive, _TRAVEL] = Field(
        False,
        description="true if gravity turns the load of a rotary axis with y in rad, or for another unit of y the "
        "travel of one turn",
    )
    cogging: Travel | None = Field(None, description="the pitch of a cogging force in the unit of y")
    friction_period: Travel | None = Field(
        None, description="the period of friction along the travel, in the unit of y"
    )
    unknown: tuple[UnknownTerm, ...] = Field(
        (),
        strict=False,
        description='terms like { signal = "output", derivative = 2, name = "inertia", unit = "kg m2" }',
    )
    known: tuple[KnownTerm, ...] = Field(
        (KnownTerm(),), strict=False, description='terms like { signal = "input", coefficient = 0.35 }'
    )

    #: The equation of a model that came as an object, in place of `unknown` and `known`.
    _model: EquationModel | None = PrivateAttr(None)

    @model_validator(mode="after")
    def _one_kind(self) -> Self:
        if self.kind == "drive" and self.input_gain is None:
            raise ValueError("input_gain is missing; give the force in N per unit of u, for example 2.0")
        if self.kind != "equation" and (self.unknown or "known" in self.model_fields_set):
            raise ValueError(
                'the lists "unknown" and "known" belong to kind = "equation"; add kind = "equation", or drop the lists'
            )
        own = set(keys_of(Drive)) - {"dead_time", "lag"} & self.model_fields_set
        if self.kind == "equation" and own:
            raise ValueError(
                f'{", ".join(sorted(own))} belongs to kind = "drive"; write it as a term in the list "unknown" '
                f'or "known"'
            )
        self._check_transfer_function()
        try:
            self.make()
        except UsageError as error:
            raise ValueError(str(error)) from None
        return self

    def _check_transfer_function(self) -> None:
        wanted, of_drive, of_process = (
            self.kind == "transfer_function",
            set(keys_of(Drive)),
            set(keys_of(TransferFunction)),
        )
        own = (of_process - of_drive) & self.model_fields_set
        if wanted and (self.n is None or self.m is None):
            raise ValueError("n or m is missing; give the numbers of poles and zeros, or search: pmfid terms RECORD")
        if own and not wanted:
            raise ValueError(f'{", ".join(sorted(own))} needs kind = "transfer_function"; add that, or drop the key')
        foreign = ({*of_drive, "unknown", "known"} - of_process) & self.model_fields_set
        if wanted and foreign:
            raise ValueError(f"{', '.join(sorted(foreign))} does not belong to a transfer function; drop the key")

    def make(self) -> Model:
        """Return the model that the section describes. Raises UsageError if the terms make no equation."""
        if self._model is not None:
            return self._model
        if self.kind == "equation":
            unknown = tuple(
                Term(**(dict(term) | {"shape": None if term.shape is None else term.shape.make()}))
                for term in self.unknown
            )
            known = tuple(Term(**dict(term)) for term in self.known)
            return EquationModel(Equation(unknown, known, dead_time=self.dead_time, lag=self.lag))
        cls = MODELS[self.kind]
        return cls(**{key: getattr(self, key) for key in keys_of(cls)})


def keys_of(model: type[Drive | TransferFunction]) -> tuple[str, ...]:
    """Return the keys of [model] for a class of models, which are the names of its fields."""
    return tuple(field.name for field in fields(model) if field.name not in NOT_IN_FILES)


def model_section(model: Model) -> ModelConfig:
    """Return the section [model] of a model that is an object. Raises UsageError for a model that no section has."""
    if isinstance(model, TransferFunction) and model.initial_conditions:
        raise UsageError("the fit always includes the initial conditions of each experiment: drop initial_conditions")
    if isinstance(model, Drive | TransferFunction):
        keys = {key: getattr(model, key) for key in keys_of(type(model))}
        if keys.get("axis") == "linear":  # the unit of the encoder may say that the axis is rotary
            del keys["axis"]
        return ModelConfig(kind=cast(KindName, model.kind), **keys)
    if not isinstance(model, EquationModel):
        raise UsageError(f"model must be a Drive, an EquationModel or a TransferFunction, got {type(model).__name__}")
    equation = model.equation
    if equation != Equation(equation.unknown, equation.known, dead_time=equation.dead_time, lag=equation.lag):
        raise UsageError(
            "the arguments delay, only_simulated and further belong to a TransferFunction: give model = "
            "TransferFunction(...)"
        )
    section = ModelConfig.model_construct(kind="equation", dead_time=equation.dead_time, lag=equation.lag)
    section._model = model
    return section
