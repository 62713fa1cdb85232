/* The estimate of one axis after a step. SPDX-License-Identifier: Apache-2.0 */
#include "pmf_internal.h"

const pmf_estimate_t *pmf_estimate(const pmf_config_t *config, const pmf_state_t *state)
{
    if (PMF_LIFTS(config)) {
        return PMF_LIFTED(state);
    }
    return PMF_MODELLED(config) ? pmf_instrument_estimate(state) : &state->direct.estimate;
}

real_t pmf_variance(const pmf_config_t *config, const pmf_state_t *state, uint32_t parameter)
{
    const pmf_estimate_t *estimate = pmf_estimate(config, state);
    real_t inflation = estimate->inflation[parameter], variance;
    if (!(estimate->innovation_variance > PMF_R(0.0))) {
        return PMF_UNKNOWN;
    }
    variance = estimate->variance_factor[parameter] * estimate->innovation_variance *
               (inflation > PMF_R(0.0) ? inflation : PMF_R(1.0));
    return variance < PMF_UNKNOWN ? variance : PMF_UNKNOWN; /* the value may also be infinite */
}

void pmf_recursion_covariance(const pmf_recursion_config_t *config, const pmf_recursion_state_t *recursion, real_t *p)
{
    uint32_t n = config->n_parameters, i, j, k, column;
    for (column = 0; column < n; ++column) {
        real_t x[PMF_MAX_PARAMETERS];
        for (i = 0; i < n; ++i) {
            x[i] = i == column ? PMF_R(1.0) : PMF_R(0.0);
            for (k = 0; k < i; ++k) {
                x[i] -= recursion->factor[i][k] * x[k];
            }
        }
        for (i = 0; i < n; ++i) {
            x[i] *= recursion->inverse_pivot[i];
        }
        for (j = n; j-- > 0U;) {
            for (k = j + 1U; k < n; ++k) {
                x[j] -= recursion->factor[k][j] * x[k];
            }
        }
        for (i = 0; i < n; ++i) { /* the copied lower half makes the matrix symmetric to the last bit */
            p[i * n + column] = i >= column ? x[i] : p[column * n + i];
        }
    }
}

/* Compute the constant's row and column for the output itself. */
static void lift_covariance(const pmf_config_t *config, const pmf_state_t *state, real_t *p)
{
    uint32_t n = config->direct.n_parameters, constant = config->direct.constant, i;
    const real_t *lowest = &p[config->direct.lowest * n];
    for (i = 0; i < n; ++i) {
        if (i != constant) {
            p[constant * n + i] += PMF_LIFT(&state->direct) * lowest[i];
            p[i * n + constant] = p[constant * n + i];
        }
    }
    p[constant * n + constant] = PMF_LIFTED(state)->variance_factor[constant];
}

void pmf_covariance_factor(const pmf_config_t *config, const pmf_state_t *state, real_t *p)
{
    if (PMF_MODELLED(config)) {
        pmf_instrument_covariance(config, state, p);
        return;
    }
    pmf_recursion_covariance(&config->direct, &state->direct, p);
    if (PMF_LIFTS(config)) {
        lift_covariance(config, state, p);
    }
}
