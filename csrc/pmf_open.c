/* Opens the memory of an estimate: P grows, theta stays.
 * SPDX-License-Identifier: Apache-2.0
 */
#include "pmf.h"

/* W, Z and v by the same factor: theta = W^-1 v stays, P grows by 1 / keep. */
static void open_all(uint32_t p, pmf_recursion_state_t *state, real_t keep)
{
    uint32_t i, j;
    for (i = 0; i < p; ++i) {
        for (j = 0; j < p; ++j) {
            state->sums.cross[i][j] *= keep;
            state->sums.square[i][j] *= keep;
        }
        state->sums.right[i] *= keep;
        state->peak[i] *= keep; /* else the regularisation would take the new information for a poor one */
    }
    state->sums.weight *= keep;
    state->sums.squares *= keep * keep;
}

/* One parameter alone: R = L D L^T becomes R - (1 - keep) r r^T / R_ii, r = R e_i, so that what is known of the others
 * for given theta_i stays. With instruments R = W^T Z^-1 W, and W - (1 - sqrt keep) W e_i r^T / R_ii has that R. */
static void open_one(const pmf_recursion_config_t *config, pmf_recursion_state_t *state, uint32_t one, real_t keep,
                     real_t root)
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
            state->sums.cross[i][j] -= config->instrumental != 0U ? (PMF_R(1.0) - root) * column[i] * r[j] / r[one]
                                                             : (PMF_R(1.0) - keep) * r[i] * r[j] / r[one];
        }
    }
    for (i = 0; i < p; ++i) {
        state->sums.right[i] = PMF_R(0.0);
        for (j = 0; j < p; ++j) {
            state->sums.right[i] += (config->instrumental == 0U && j > i ? state->sums.cross[j][i] : state->sums.cross[i][j]) *
                               state->estimate.theta[j];
        }
    }
    state->peak[one] *= keep;
}

static void open_recursion(const pmf_recursion_config_t *config, pmf_recursion_state_t *state, uint32_t parameter,
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
        open_one(config, state, parameter, keep, root);
    }
#if PMF_WINDOW_BLOCKS > 0
    if (config->scheme == PMF_WINDOW) { /* what is left counts as the newest block */
        pmf_clear(state->window, (uint32_t)sizeof state->window);
        state->window[state->window_block] = state->sums;
    }
#endif
    state->weight *= keep; /* the innovations since the change say nothing of the noise */
    state->innovation_square *= keep;
    state->blocks = 0U; /* nor of how white it is */
    state->block_updates = 0U;
    for (i = 0; i < config->n_parameters; ++i) {
        state->score[i] = PMF_R(0.0);
        state->estimate.inflation[i] = config->correlated;
    }
}

#if PMF_WITH_AUXILIARY
/* The parameter of the direct estimate that has a part of the instrumental one's; all where none has. */
static uint32_t direct_part(const pmf_auxiliary_config_t *config, uint32_t parameter)
{
    uint32_t role;
    for (role = 0; role < PMF_ROLES; ++role) {
        if (parameter != PMF_NO_PARAMETER && config->index[role] == parameter) {
            return config->direct_index[role];
        }
    }
    return PMF_NO_PARAMETER;
}
#endif

void pmf_open(const pmf_config_t *config, pmf_state_t *state, uint32_t parameter, real_t root)
{
#if PMF_WITH_AUXILIARY
    if (config->auxiliary.enabled != 0U) {
        open_recursion(&config->instrument, &state->instrument, parameter, root);
        parameter = direct_part(&config->auxiliary, parameter);
    }
#endif
#if PMF_LINEAR
    if (config->linear.enabled != 0U) {
        open_recursion(&config->instrument, &state->instrument, parameter, root);
    }
#endif
    open_recursion(&config->direct, &state->direct, parameter, root);
}
