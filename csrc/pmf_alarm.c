/* Alarm on a parameter by the two-sided cumulative sum of a log-likelihood ratio (Page 1954).
 * SPDX-License-Identifier: Apache-2.0
 *
 * The sums use one value of the estimate in `interval` samples, so that its errors are nearly independent. With x =
 * theta - nominal of variance v, the ratio of a shift by s is s (x - s / 2) / v. The sums stay if the status marks
 * the estimate as unreliable or if the variance is large: without excitation no alarm is raised. */
#include "pmf_internal.h"

static const uint32_t UNTRUSTED = (uint32_t)PMF_NOT_AN_ESTIMATE | (uint32_t)PMF_UNMODELLED;
static const real_t LEAST_VARIANCE = PMF_R(1e-30); /* keeps a division by zero finite */

/* Return max(0, sum + gain), limited to twice the threshold, so that the sum falls after a repair. */
static real_t next_sum(real_t sum, real_t gain, real_t threshold)
{
    real_t next = sum + gain, most = threshold + threshold;
    if (!(next > PMF_R(0.0))) {
        return PMF_R(0.0);
    }
    return next < most ? next : most;
}

int32_t pmf_alarm_step(const pmf_alarm_config_t *alarm, pmf_alarm_state_t *sums, const pmf_config_t *config,
                       const pmf_state_t *state)
{
    real_t variance = pmf_variance(config, state, alarm->parameter), apart, gain;
    uint32_t trusted = (PMF_STATUS(state) & UNTRUSTED) == 0U && variance < PMF_UNKNOWN ? 1U : 0U;
    sums->wait += sums->wait < alarm->interval ? 1U : 0U;
    if (trusted != 0U && sums->wait >= alarm->interval) {
        apart = pmf_estimate(config, state)->theta[alarm->parameter] - alarm->nominal;
        gain = alarm->shift / (variance + LEAST_VARIANCE);
        sums->up = next_sum(sums->up, gain * (apart - PMF_R(0.5) * alarm->shift), alarm->threshold);
        sums->down = next_sum(sums->down, gain * (-apart - PMF_R(0.5) * alarm->shift), alarm->threshold);
        sums->wait = 0U;
    }
    if (sums->up < alarm->threshold && sums->down < alarm->threshold) {
        return 0;
    }
    return sums->up >= sums->down ? 1 : -1;
}
