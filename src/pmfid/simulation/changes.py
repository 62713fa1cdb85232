"""What happens to a machine while it runs: schedules of its parameters."""

from dataclasses import replace

from pmfid.simulation.drive import DriveParameters, Schedule


def mass_step(parameters: DriveParameters, mass: float, at: float) -> Schedule:
    """A load is put down: the mass becomes `mass` [kg] at the time `at` [s] > 0. Raises ValueError."""
    return Schedule(((0.0, parameters), (at, replace(parameters, mass=mass))))


def mass_ramp(parameters: DriveParameters, mass: float, at: float, ramp: float) -> Schedule:
    """A container fills: the mass moves to `mass` [kg] from `at` [s] > 0 on in `ramp` [s]. Raises ValueError."""
    return Schedule(((0.0, parameters), (at, replace(parameters, mass=mass))), (0.0, ramp))


def friction_growth(parameters: DriveParameters, factor: float, at: float, ramp: float) -> Schedule:
    """A guide runs dry: viscous and Coulomb friction grow by `factor` from `at` [s] > 0 on in `ramp` [s]."""
    worn = replace(
        parameters,
        viscous_friction=factor * parameters.viscous_friction,
        coulomb_friction=factor * parameters.coulomb_friction,
    )
    return Schedule(((0.0, parameters), (at, worn)), (0.0, ramp))


def slipping_belt(parameters: DriveParameters, part: float, at: float) -> Schedule:
    """A belt slips: from `at` [s] > 0 on only `part` of the force arrives (input_gain). Raises ValueError.

    An estimator that goes on with the old input_gain finds every parameter larger by 1 / part.
    """
    return Schedule(((0.0, parameters), (at, replace(parameters, input_gain=part * parameters.input_gain))))
