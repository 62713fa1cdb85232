/* Open the memory of an estimate, so that P grows and theta stays. SPDX-License-Identifier: Apache-2.0 */
#include "pmf_internal.h"

static const real_t FAINT = PMF_EITHER(1e-6, 1e-14); /* fraction of a number, slightly more than its rounding */

/* Return the contribution of the columns' known noise to their products. */
static real_t feigned(const pmf_recursion_config_t *config, const pmf_recursion_state_t *state, uint32_t i, uint32_t j)
{
    return config->compensated != 0U ? state->sums.weight * config->noise[i][j] : PMF_R(0.0);
}

/* Multiply W and Z by the same factor: theta stays, P grows by 1 / keep. */
static void open_all(uint32_t p, pmf_recursion_state_t *state, real_t keep)
{
    uint32_t i, j;
    for (i = 0; i < p; ++i) {
        for (j = 0; j < p; ++j) {
            state->sums.cross[i][j] *= keep;
            state->sums.square[i][j] *= keep;
        }
        state->peak[i] *= keep; /* otherwise the regularisation would take the new information for poor */
    }
    state->sums.weight *= keep;
    state->sums.squares *= keep * keep;
}

/* Open one parameter alone. The information R = W or W^T Z^-1 W becomes R - (1 - keep) r r^T / R_ii with r = R e_i. The
 * information on the other parameters for given theta_i stays. In L D L^T with parameter i first, only the pivot of i
 * shrinks.
 *
 * Least squares takes the information R from the sums. The factors of the last step also hold the regularisation. The
 * regularisation may exceed the kept part, so that the diagonal would become negative. */
static void open_squares(const pmf_recursion_config_t *config, pmf_recursion_state_t *state, uint32_t one, real_t keep)
{
    uint32_t p = config->n_parameters, i, j;
    real_t r[PMF_MAX_PARAMETERS], own = state->sums.cross[one][one] - feigned(config, state, one, one);
    if (!(own >
          FAINT * state->sums.cross[one][one])) { /* without information on the parameter, nothing can be removed */
        return;
    }
    for (i = 0; i < p; ++i) {
        r[i] = (i < one ? state->sums.cross[one][i] : state->sums.cross[i][one]) - feigned(config, state, i, one);
    }
    for (i = 0; i < p; ++i) {
        real_t before = state->sums.cross[i][i] - feigned(config, state, i, i), after;
        for (j = 0; j <= i; ++j) {
            real_t less = i == one || j == one ? r[i == one ? j : i] : r[i] * r[j] / own;
            state->sums.cross[i][j] -= (PMF_R(1.0) - keep) * less;
        }
        after = state->sums.cross[i][i] - feigned(config, state, i, i);
        if (!(after >
              FAINT * before)) { /* only rounding is left, because all information depended on the other parameter */
            after = before > PMF_R(0.0) ? FAINT * before : PMF_R(0.0);
            state->sums.cross[i][i] = after + feigned(config, state, i, i);
        }
        state->peak[i] *= before > after ? after / before : PMF_R(1.0);
    }
}

/* With instruments, W - (1 - sqrt keep) W e_i r^T / R_ii has this R, for any r. */
static void open_instruments(const pmf_recursion_config_t *config, pmf_recursion_state_t *state, uint32_t one,
                             real_t keep, real_t root)
{
    uint32_t p = config->n_parameters, i, j, k;
    real_t r[PMF_MAX_PARAMETERS], column[PMF_MAX_PARAMETERS];
    for (j = 0; j < p; ++j) {
        r[j] = PMF_R(0.0);
        for (k = 0; k <= (one < j ? one : j); ++k) {
            r[j] += (k < j ? state->factor[j][k] : PMF_R(1.0)) * (k < one ? state->factor[one][k] : PMF_R(1.0)) /
                    state->inverse_pivot[k];
        }
        column[j] = state->sums.cross[j][one];
    }
    for (i = 0; i < p; ++i) {
        for (j = 0; j < p; ++j) {
            state->sums.cross[i][j] -= (PMF_R(1.0) - root) * column[i] * r[j] / r[one];
        }
    }
    state->peak[one] *= keep;
}

void pmf_recursion_open(const pmf_recursion_config_t *config, pmf_recursion_state_t *state, uint32_t parameter,
                        real_t root)
{
    real_t keep = root * root;
    uint32_t i;
    if (state->started == 0U) {
        return;
    }
    if (parameter == PMF_NO_PARAMETER) {
        open_all(config->n_parameters, state, keep);
    } else {
        if (config->instrumental != 0U) {
            open_instruments(config, state, parameter, keep, root);
        } else {
            open_squares(config, state, parameter, keep);
        }
    }
    state->weight *= keep; /* the innovations since the change do not show the noise */
    state->innovation_square *= keep;
    state->blocks = 0U; /* the blocks before the change do not show the colour of the noise */
    state->block_updates = 0U;
    pmf_clear(state->score, (uint32_t)sizeof state->score);
    pmf_clear(state->gathered, (uint32_t)sizeof state->gathered);
    pmf_clear(state->rest, (uint32_t)sizeof state->rest);
    for (i = 0; i < config->n_parameters; ++i) {
        state->estimate.inflation[i] = config->correlated;
        if (PMF_WITH_MISREAD) {
            state->spread[i] = config->correlated;
            state->misread[i] *=
                parameter == PMF_NO_PARAMETER || parameter == i ? keep : PMF_R(1.0); /* the bias stays */
        }
    }
}

void pmf_open(const pmf_config_t *config, pmf_state_t *state, uint32_t parameter, real_t root)
{
    if (PMF_MODELLED(config)) {
        parameter = pmf_instrument_open(config, state, parameter, root);
    }
    pmf_recursion_open(&config->direct, &state->direct, parameter, root);
    if (PMF_LIFTS(config)) {
        pmf_lift(config, state);
    }
}
