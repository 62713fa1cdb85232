/* An input that acts late drives the axis in the interval of the counts. Only pmf_step.c includes this file.
 * SPDX-License-Identifier: Apache-2.0
 *
 * A dead time is whole samples and a fraction of a sample. The filters take the mean of the two inputs that share an
 * interval, because the mean acceleration depends only on it. The auxiliary model switches at the right instant. */

#if PMF_LATE

/* Between two switches the lagged input is an exponential. Two levels, one for each half of the interval, have the
 * same mean and the same first moment. They keep velocity and position at the end of the interval, except for the
 * damping within a sample. */

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

/* Delay the input after the encoder. All signals of the encoder belong to the interval before the last. */
static void delay_input(const pmf_config_t *config, pmf_state_t *state)
{
    pmf_late_state_t *late = &state->late;
    real_t *signal = state->network.node, mean;
    uint32_t kept = config->late.kept;
    if (kept == 0U) {
        return;
    }
    late->at = late->at == 0U ? kept - 1U : late->at - 1U;
    late->past[late->at] = signal[PMF_LATE_INPUT];
    late->older = late->past[(late->at + kept - 1U) % kept];
    late->newer = late->past[(late->at + kept - 2U) % kept];
    late->part = config->late.part;
    if (config->late.lags != 0U) {
        lag_input(config->late.decay, late);
    }
    mean = late->newer + late->part * (late->older - late->newer);
    signal[PMF_LATE_INPUT] = mean;
    signal[PMF_INPUT] = signal[PMF_MOVING] * mean;
}

#else
static void delay_input(const pmf_config_t *config, const pmf_state_t *state)
{
    (void)config;
    (void)state;
}
#endif
