"""Results of :func:`leafbench.plan` and :func:`leafbench.identify`, frozen."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(frozen=True)
class Margin:
    """Distance between a predicted extreme and its limit."""

    #: Key of the limit in the bench file; its ending is the unit.
    limit: str
    #: Predicted extreme, in the unit of the limit.
    predicted: float
    #: Value of the limit, in its unit.
    allowed: float
    #: Time of the extreme in s, from the start of the profile.
    at_s: float
    #: Remaining distance in percent of the limit; negative beyond it.
    margin_percent: float


@dataclass(frozen=True)
class Plan:
    """What a profile will do, predicted with the bench's model."""

    #: Name of the profile.
    profile: str
    duration_s: float
    #: Number of counted cycles.
    cycles: int
    force_min_n: float
    force_max_n: float
    displacement_min_mm: float
    displacement_max_mm: float
    velocity_max_mm_s: float
    #: Energy that the specimen dissipates, J.
    energy_j: float
    margins: tuple[Margin, ...]
    #: Limits that the profile would exceed, one sentence each; empty if it may run.
    trips: tuple[str, ...]

    @property
    def may_run(self) -> bool:
        """True if no limit is exceeded."""
        return not self.trips


@dataclass(frozen=True)
class FittedParameter:
    """A parameter of a fitted model; the end of its name is its unit."""

    name: str
    #: Empty for a pure number.
    unit: str
    value: float
    #: False where it was held.
    free: bool
    #: 95 % interval; None where held, at a bound or not identifiable.
    ci95: tuple[float, float] | None = None


@dataclass(frozen=True)
class FitError:
    """How far the fitted model is from one recording."""

    #: Name of the recording.
    of: str
    #: Root mean square of the difference in N.
    error_n: float
    #: The same in percent of the recording's range of force.
    error_percent: float


@dataclass(frozen=True)
class Identification:
    """A model fitted to recordings."""

    #: Name of the model.
    model: str
    #: All parameters, those that were held too.
    parameters: tuple[FittedParameter, ...]
    #: Sum of squared residuals, each a share of its recording's range of force.
    cost: float
    errors: tuple[FitError, ...]
    #: Evaluations of the model.
    evaluations: int
    #: True if the search met its tolerances.
    converged: bool
    #: Reasons to doubt the result, one sentence each.
    warnings: tuple[str, ...]
    #: Text of a specimen file with the values.
    specimen_toml: str = field(default="", repr=False)

    def __getitem__(self, name: str) -> FittedParameter:
        """The parameter called `name`; KeyError if there is none."""
        for parameter in self.parameters:
            if parameter.name == name:
                return parameter
        names = ", ".join(parameter.name for parameter in self.parameters)
        raise KeyError(f'{self.model} has no parameter "{name}": use one of {names}')
