/* An input with a first-order lag, such as a current loop, as two levels with the same effect on a body.
 * SPDX-License-Identifier: Apache-2.0
 *
 * Between two switches the lagged input is an exponential. Two levels, one for each half of the interval, have the same
 * mean and the same first moment. The two levels keep velocity and position at the end of the interval, except for the
 * damping within a sample.
 */
#ifndef PMF_LAG_H
#define PMF_LAG_H

#include "pmf_internal.h"

#if PMF_LATE && PMF_WITH_LAG

/* Replace the two inputs of the interval, with the older one's fraction, by two levels for half an interval each. */
static void lag_input(const pmf_decay_t *decay, pmf_late_state_t *late)
{
    real_t first = late->part, second = PMF_R(1.0) - first, half = PMF_R(0.5);
    real_t apart = late->lagged - late->older, begun, mean, moment, tilt;
    late->lagged = late->older + decay[0].rest * apart;
    begun = first * late->older + decay[0].mean * apart;
    moment = half * first * first * late->older + decay[0].moment * apart;
    apart = late->lagged - late->newer;
    late->lagged = late->newer + decay[1].rest * apart;
    mean = second * late->newer + decay[1].mean * apart;
    moment += first * mean + half * second * second * late->newer + decay[1].moment * apart;
    mean += begun;
    tilt = PMF_R(4.0) * (moment - half * mean);
    late->older = mean - tilt;
    late->newer = mean + tilt;
    late->part = half;
}

#endif
#endif
