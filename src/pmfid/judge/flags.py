"""Meaning of the flags of whole records, in addition to the bits of `Status`."""

from __future__ import annotations

#: Name -> what it means, and what to do.
FLAGS = {
    "model_spread": (
        "something that machines have, Stribeck friction or a dead time, would not show in this record, and would move "
        "a parameter beyond its standard error and the tolerance; of a transfer function, the record does not tell the "
        "hold of its input"
    ),
    "biased": "the method has an error of its own here, beyond its standard error; the note has the better number",
    "std_too_small": "the standard error leaves out the method's own error; the note says how large that is",
    "not_followed": "the simulated motion does not follow the record: the model, a sign or a column is wrong",
    "prior_contradicted": (
        "what is known beforehand and the record are three standard deviations apart, or more: one of them is wrong"
    ),
    "uncertain": "a parameter is not known to half its value: excite it more, or use a simpler model",
    "implausible": "a parameter is negative that never is in a machine: check sign and scale of input and encoder",
    "coarse_motion": "the axis moves less than a count per sample, and this method needs more: use iv",
    "unstable": (
        "a pole is in the right half-plane, and no controller is known to hold it: set unstable = true if one does"
    ),
    "ambiguous_term": "two terms explain the record alike: record a motion that tells them apart",
    "unresolved": "no term that was searched explains all that the record shows",
    "reversed": "the output has the opposite sign of the input: turn one of them",
    "exchanged": "the columns of input and output are exchanged: name each by what it is",
    "gravity": "gravity turns the load of a rotary axis, and the model has none: set gravity = true in [model]",
    "velocity": "the output is a velocity and is read as a position: say so by output_kind, or integrate it",
    "wrapped": "the counter restarts at the end of its range, and nothing has undone that: give bits, or range",
    "stuck": "the output stands still while the axis goes on: the counter, or what reads it, was stuck",
    "clipped": "the output ends while the axis goes on: the range of the counter or the sensor ends there",
    "saturated": "the input stays at its largest or smallest value: right where the drive gave no more, else cut off",
    "held_output": "the output is read more slowly than the record: keep only the rows with a new value",
    "held_input": "the input changes at every few rows and no other: log it at the rate at which the drive gets it",
    "little_motion": "the axis moves too little, or too evenly, to tell anything: record reversals and varying speed",
    "rate_low": "the velocity changes by too much from row to row: record at a shorter sample period",
    "rate_high": "nearly all rows are without a count: keep every few of them, with the mean of the input",
    "drift": "input and output are of two clocks: log both by one",
}
