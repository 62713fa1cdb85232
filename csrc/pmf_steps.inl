/* The time between samples, if it varies. Only pmf_step.c includes this file. SPDX-License-Identifier: Apache-2.0 */

#if PMF_STEPS
void pmf_set_step(const pmf_config_t *config, pmf_state_t *state, real_t step)
{
    real_t ratio = step * config->encoder.rate;
    state->encoder.ratio = ratio > PMF_LEAST_RATIO && ratio < PMF_MOST_RATIO ? ratio : PMF_R(0.0);
}
#endif

static void begin_steps(pmf_state_t *state)
{
    (void)state;
#if PMF_STEPS
    state->encoder.ratio = PMF_R(1.0);
    state->encoder.ratio_before = PMF_R(1.0);
#endif
}

/* Give the step of this interval to the network, and sum the steps of the last 256 samples. Their mean square over time
 * gives long steps more weight. */
static void pass_step(const pmf_config_t *config, pmf_state_t *state)
{
    (void)config;
    (void)state;
#if PMF_STEPS
    if (PMF_SPACED(config)) {
        static const scalar_t RECENT = PMF_SCALAR(0.99609375);
        pmf_network_state_t *network = &state->network;
        real_t longest = (real_t)PMF_LONGEST, step;
        network->ratio = state->encoder.ratio;
        network->ratio_before = state->encoder.ratio_before;
        state->encoder.ratio_before = state->encoder.ratio;
        state->encoder.ratio = PMF_R(1.0);
        step = network->ratio < longest ? network->ratio : longest;
        network->time = RECENT * network->time + step;
        network->cubes = RECENT * network->cubes + step * step * step;
    }
#endif
}

/* Return a status if the mean square of the step over time [squared periods] makes direct methods err by percents. */
static whole_t judge_bursts(const pmf_config_t *config, const pmf_state_t *state)
{
    whole_t status = PMF_W(0);
    (void)config;
    (void)state;
#if PMF_STEPS
    status = PMF_BIT(PMF_TURNED(&config->encoder) != 0U && state->network.cubes > PMF_R(2.0) * state->network.time,
                     PMF_UNMODELLED);
#endif
    return status;
}
