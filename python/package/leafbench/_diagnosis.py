"""The result of a diagnosis: the fields of ``diagnosis.json`` (docs/formats.md), frozen.

A number that is not finite, null in the file, is NaN here. A list is a tuple. A list of name and value is a dict. ``from``, a word
of Python, is ``from_``.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal

from ._from_json import from_json

Verdict = Literal["adequate", "missing_physics", "unexplained"]
Direction = Literal["loading", "unloading", "both"]


@dataclass(frozen=True)
class Value:
    """A value with its 95 % interval."""

    name: str
    value: float
    #: Empty for a pure number.
    unit: str
    #: ``(low, high)``, or None if the data give no interval.
    ci95: tuple[float, float] | None = None


@dataclass(frozen=True)
class Finding:
    """A missing effect."""

    #: Code of physics (docs/formats.md).
    code: str
    #: Probability that this code is right, 0 to 0.99.
    confidence: float
    #: A sentence for a technician.
    statement: str
    parameters: tuple[Value, ...]
    #: Codes that the recordings cannot tell apart, this one first; empty where they can.
    group: tuple[str, ...] = ()
    #: Standard deviation of the size between recordings and branches, as a share of the size.
    size_spread: float | None = None
    #: Gain in log-likelihood of effective samples that the effect brings.
    gain: float | None = None


@dataclass(frozen=True)
class Alternative:
    """An effect that could replace a finding."""

    code: str
    #: Code of the finding, or ``unknown``.
    instead_of: str
    #: Why the recordings do not separate the two.
    why: str
    #: The test that would separate them.
    test: str


@dataclass(frozen=True)
class Exponent:
    """A power with its 95 % interval."""

    value: float
    ci95: tuple[float, float]


@dataclass(frozen=True)
class Law:
    """A force over one axis that was read off the recordings."""

    #: As in :attr:`Location.axis`.
    axis: str
    #: True if it opposes the motion, False if it is the same on both branches.
    opposes_motion: bool
    #: True if the values are shares of the carried load, False if they are forces in N.
    per_load: bool
    #: Places on the axis, in its unit.
    at: tuple[float, ...]
    #: Values at the places: N, or a share of the load.
    force: tuple[float, ...]
    #: Standard deviation of each value.
    band: tuple[float, ...] = ()
    #: The shortest equation within the band.
    equation: str = ""
    #: Power of the axis, where the equation has one.
    exponent: Exponent | None = None
    #: Part of the difference above the noise that it takes away on cycles that were not fitted, 0 to 1.
    explained_share: float = float("nan")
    #: NRMSE on held-out cycles before and after.
    nrmse_leftout: tuple[float, float] | None = None
    #: The law as a sentence.
    statement: str = ""


@dataclass(frozen=True)
class Location:
    """A place on the loop where model and recordings differ."""

    #: ``displacement_mm``, ``force_n``, ``velocity_mm_s``, ``time_s``, ``cycle`` or ``distance_from_reversal_mm``.
    axis: str
    #: Lower end, in the unit of the axis.
    from_: float
    #: Upper end, in the unit of the axis.
    to: float
    direction: Direction
    #: Share of the residual's energy above the noise that lies in it, 0 to 1.
    share: float
    #: The same as a sentence.
    words: str


@dataclass(frozen=True)
class Errors:
    """Errors of one model; pure numbers."""

    #: rms(measured - model) / (max - min of measured force), on fitted cycles.
    nrmse_train: float
    #: The same on cycles that nothing was fitted to and nothing chosen by.
    nrmse_heldout: float
    #: Relative error of the largest force, the worst recording.
    peak_force_error: float
    #: Relative error of the loop energy, with sign.
    loop_energy_error: float


@dataclass(frozen=True)
class Rung:
    """One step from the nominal model to the improved one."""

    #: What was added in this step.
    what: str
    errors: Errors


@dataclass(frozen=True)
class FitErrors:
    """Errors before and after the diagnosis."""

    #: The baseline with its own parameters refitted.
    baseline: Errors
    #: The baseline with the missing effects.
    improved: Errors
    #: RMS of the noise divided by the range of force: no model can have less.
    noise_floor_nrmse: float
    ladder: tuple[Rung, ...] = ()


@dataclass(frozen=True)
class NextTest:
    """The test to run next."""

    #: Text of a profile file; ``leafbench.simulate`` and ``leafbench.plan`` take it.
    profile_toml: str
    why: str
    #: Duration in s.
    duration_s: float
    #: Difference of the two explanations over the profile, in standard deviations of the noise.
    separation_sigma: float | None = None


@dataclass(frozen=True)
class NoteSize:
    """A size with its unit."""

    value: float
    #: ``N``, ``mm``, ``s``, ``ms``, ``J`` or ``samples``.
    unit: str


@dataclass(frozen=True)
class Note:
    """What is imperfect about a recording, and what was done about it."""

    recording: str
    kind: str
    size: NoteSize
    done: Literal["corrected", "masked", "refused", "told"]
    #: One sentence: what, where, what to do.
    text: str


@dataclass(frozen=True)
class Candidate:
    """A set of effects that was compared."""

    codes: tuple[str, ...]
    #: Gain over the refitted baseline, in log-likelihood of effective samples.
    gain: float
    #: The same on selecting cycles alone.
    gain_heldout: float
    chosen: bool


@dataclass(frozen=True)
class NotTestable:
    """An effect that these recordings cannot show."""

    code: str
    #: Share of the effect that the baseline cannot imitate, 0 to 1.
    surviving: float
    why: str


@dataclass(frozen=True)
class Curve:
    """One recording with the forces of both models, thinned to about 600 points; columns of equal length."""

    name: str
    time_s: tuple[float, ...]
    displacement_mm: tuple[float, ...]
    measured_n: tuple[float, ...]
    baseline_n: tuple[float, ...]
    improved_n: tuple[float, ...]
    #: Indices of points before which points are missing or masked.
    breaks: tuple[int, ...]
    remarks: tuple[str, ...]
    nrmse_baseline: float
    nrmse_improved: float


@dataclass(frozen=True)
class Map:
    """Mean residual along an axis in N; NaN where a bin is empty."""

    axis: str
    #: Edges of the bins, in the unit of the axis; one more than bins.
    edges: tuple[float, ...]
    loading_n: tuple[float, ...]
    unloading_n: tuple[float, ...]
    improved_loading_n: tuple[float, ...]
    improved_unloading_n: tuple[float, ...]


@dataclass(frozen=True)
class AttachedEffect:
    """An effect of the improved model."""

    code: str
    #: Values by name; the end of a name is its unit.
    parameters: dict[str, float]


@dataclass(frozen=True)
class ImprovedModel:
    """The baseline with the missing effects, all parameters identified."""

    model: str
    #: Values by name; the end of a name is its unit.
    parameters: dict[str, float]
    structure: dict[str, Any]
    #: Specimen first.
    effects: tuple[AttachedEffect, ...]
    law: Law | None
    #: Zero of the force channel that the fit found, N.
    force_zero_n: float


@dataclass(frozen=True)
class Yardstick:
    """Error of a model of hysteresis that knows nothing of springs."""

    name: str
    #: NRMSE on the points of ``fit.baseline.nrmse_heldout``.
    nrmse_leftout: float


@dataclass(frozen=True)
class Proof:
    """What the improved bench file does when it is read back and simulated."""

    #: Which points were left out, in words.
    left_out: str
    #: NRMSE of the improved model, stepped at the sampling rate along the motion of the recordings; None if the file is refused.
    simulated_nrmse: float | None
    #: The same over the raw samples of the displacement with their noise, as a twin sees them.
    twin_nrmse: float | None
    #: NRMSE of the refitted baseline, in the same way.
    baseline_nrmse: float | None
    #: True if there is an improved bench file.
    written: bool
    #: What follows, as a sentence.
    words: str


@dataclass(frozen=True)
class LeftOut:
    """Errors on a recording that nothing was fitted to; NRMSE over its own range of force."""

    recording: str
    baseline: float | None
    improved: float | None
    yardsticks: tuple[Yardstick, ...]


@dataclass(frozen=True)
class Diagnosis:
    """What a diagnosis found. ``str(diagnosis)`` is its summary."""

    #: ``adequate``, ``missing_physics`` or ``unexplained``.
    verdict: Verdict
    #: The verdict in one or two sentences.
    summary: str
    #: What is missing; empty unless the verdict is ``missing_physics``.
    effects: tuple[Finding, ...]
    alternatives: tuple[Alternative, ...]
    #: Places where model and recordings differ.
    location: tuple[Location, ...]
    fit: FitErrors
    baseline_parameters: tuple[Value, ...]
    #: Parameters that are at a bound, implausible or not identifiable; a wrong zero; masked parts.
    alarms: tuple[str, ...]
    #: What is imperfect about the recordings; read it first.
    notes: tuple[Note, ...]
    #: Sets of effects that were compared, best first.
    candidates: tuple[Candidate, ...] = field(repr=False)
    not_testable: tuple[NotTestable, ...] = field(repr=False)
    #: Part of the baseline's residual above the noise that no effect explains, 0 to 1.
    unexplained_share: float
    curves: tuple[Curve, ...] = field(repr=False)
    maps: tuple[Map, ...] = field(repr=False)
    improved: ImprovedModel
    yardsticks: tuple[Yardstick, ...] = field(repr=False)
    #: Where no effect explains the recordings, a law that does.
    law: Law | None = None
    next_test: NextTest | None = None
    #: Why there is no next test although nothing is named.
    no_next_test: str | None = None
    #: True if the search spent its budget before sets of three effects were compared.
    search_cut_short: bool = False
    #: Name of the only recording that is not explained; it has no cycle that could be held out, and ``next_test`` repeats its ramp.
    single_sweep: str | None = None
    #: RMS of the difference that has the shape of the friction law and is not named, as a share of the RMS friction.
    friction_shape_share: float | None = None
    #: The same of the spring's curve, as a share of the force range.
    curve_shape_share: float | None = None
    #: Gain in log-likelihood of the free shape of the friction law and the curve, before any effect is named.
    free_laws_gain: float = 0.0
    proof: Proof | None = None
    #: Errors on the recordings that were only predicted.
    left_out: tuple[LeftOut, ...] = ()
    #: Text of a bench file with the missing physics added; None if it is no better than the refitted baseline.
    improved_toml: str | None = field(default=None, repr=False)
    #: Text of ``diagnosis.json``, on one line.
    json: str = field(default="", repr=False)

    def __str__(self) -> str:
        return self.summary


def diagnosis_of(json: str, improved_toml: str | None) -> Diagnosis:
    """The diagnosis that the compiled half wrote as JSON."""
    return from_json(Diagnosis, json, json=json, improved_toml=improved_toml)
