/* Errors of direction and moving fraction, because counts show a start, a stop or a reversal late. Only pmf_encoder.c
 * includes this file. SPDX-License-Identifier: Apache-2.0
 *
 * An interval without a count moves, rests or reverses. The encoder reads a motion until the pause is too long. A pause
 * as long as the last one is usual in slow motion and counts only if it ends in a stop or a reversal. Every further
 * interval counts at once. */

static const scalar_t LATE_TURN =
    PMF_SCALAR(0.3); /* error of the direction if velocities give the instant of a reversal [samples] */
static const scalar_t LATE_STOP = PMF_SCALAR(0.5); /* mean part of the last interval that was at rest */
static const scalar_t HIDDEN =
    PMF_SCALAR(1.5); /* time from a start to the first count, over the time from there to the second count */

/* Write the errors of an interval. `moved` and `direction` are the reading before the interval, and `fast` means that
 * the tracker gives the instants of reversals. */
static void emit_misread(pmf_encoder_state_t *state, integer_t change, truth_t moved, real_t direction, truth_t fast,
                         real_t *signal)
{
    pmf_misread_state_t *own = &state->misread;
    real_t zero = PMF_R(0.0), one = PMF_R(1.0), u = state->input, size = PMF_TO_REAL(change), sign, begun;
    real_t rests = zero, pushed = zero, turned = zero, hidden = zero;
    truth_t counted = change != 0, stops, turns, usual;
    sign = PMF_IF(change > 0, one, PMF_IF(counted, -one, zero));
    size = PMF_IF(counted, PMF_SIZE(size), one);
    stops = PMF_NOT(counted) & moved & PMF_NOT(state->moving > zero);
    turns = counted & moved & PMF_NOT(sign * direction > zero);
    usual = fast | (own->pause < own->usual);
    /* a start, from its first count, or from the second if the first does not show the speed */
    begun = PMF_IF(moved, own->begun, one);
    hidden = PMF_IF(counted & (begun > zero), HIDDEN * begun / size, zero);
    own->begun = PMF_IF(counted, PMF_IF(moved | (size > one), zero, one),
                        PMF_IF((own->begun > zero) & moved & PMF_NOT(stops), own->begun + one, zero));
    /* a stop, or a pause that is too long */
    rests = PMF_IF(stops, own->held + LATE_STOP, PMF_IF(PMF_NOT(counted) & moved & PMF_NOT(usual), one, zero));
    pushed = PMF_IF(stops, own->held_input + LATE_STOP * u, PMF_IF(rests > zero, u, zero));
    /* a reversal: the input may have held the axis before */
    turned = PMF_IF(turns, PMF_IF(fast, LATE_TURN * (one + own->held), LATE_TURN + own->held), zero);
    pushed = PMF_IF(turns & PMF_NOT(fast) & (own->held_input * direction < zero), own->held_input, pushed);
    signal[PMF_MISREAD_INPUT] = pushed - hidden * u;
    signal[PMF_MISREAD_DIRECTION] = (rests + turned) * direction - hidden * sign;
    signal[PMF_MISREAD_MOVING] = rests - hidden;
    own->usual = PMF_IF(counted, PMF_IF(moved, own->pause, zero), own->usual);
    own->pause = PMF_IF(counted | stops | PMF_NOT(moved), zero, own->pause + one);
    usual = usual & moved & PMF_NOT(counted | stops);
    own->held = PMF_IF(counted | stops, zero, PMF_IF(usual, own->held + one, own->held));
    own->held_input = PMF_IF(counted | stops, zero, PMF_IF(usual, own->held_input + u, own->held_input));
}
