/* Amount and time of forgetting in the sums of a recursion. Only pmf_recursion.c includes this file.
 * SPDX-License-Identifier: Apache-2.0 */
#ifndef PMF_FORGETTING_H
#define PMF_FORGETTING_H

#include "pmf_algebra.h"

#define SATURATED 0xffffffffU
#ifdef PMF_PARAMETERS
#define PARAMETERS(config) PMF_PARAMETERS
#define INSTRUMENTAL(config) PMF_INSTRUMENTAL
#else
#define PARAMETERS(config) ((config)->n_parameters)
#define INSTRUMENTAL(config) ((config)->instrumental)
#endif
#define SPED_UP 1U
#define SLOWED_DOWN 2U

#define LARGER(a, b) PMF_IF((a) > (b), a, b)

/* If a model follows the estimate, the first samples come from a poor model. Until the memory is full, the weight of a
 * sample is proportional to its number, so that early errors fade with the square of time. */
PMF_INLINE real_t memory_of(const pmf_recursion_config_t *config, const pmf_recursion_state_t *state, real_t weight)
{
#if PMF_WITH_AUXILIARY
    if (config->growing != 0U) {
#if PMF_SHAPED
        real_t power = (real_t)config->growing;
#else
        real_t power = PMF_R(1.0);
#endif
        real_t updates = PMF_TO_REAL(state->updates), part = updates / (updates + power);
        weight = PMF_IF(part < weight, part, weight);
    }
#else
    (void)config;
    (void)state;
#endif
    return weight;
}

PMF_INLINE void add_sample(pmf_sums_t *sums, real_t f, const real_t *column, uint32_t p, uint32_t instrumental,
                           truth_t with_right)
{
    const real_t *zeta = instrumental != 0U ? &column[p + 1U] : column;
    uint32_t i, j;
    for (i = 0; i < p; ++i) {
        for (j = 0; j < (instrumental != 0U ? p : i + 1U); ++j) {
            sums->cross[i][j] = f * sums->cross[i][j] + zeta[i] * column[j];
        }
        if (instrumental != 0U) {
            for (j = 0; j <= i; ++j) {
                sums->square[i][j] = f * sums->square[i][j] + zeta[i] * zeta[j];
            }
        }
        if (PMF_ANY(with_right)) {
            sums->right[i] = PMF_IF(with_right, f * sums->right[i] + zeta[i] * column[p], sums->right[i]);
        }
    }
    sums->weight = f * sums->weight + PMF_R(1.0);
    sums->squares = f * f * sums->squares + PMF_R(1.0);
}

#if PMF_ENDLESS
PMF_SELDOM void discount_sums(pmf_sums_t *sums, uint32_t p, real_t factor)
{
    uint32_t i, j;
    for (i = 0; i < p; ++i) {
        sums->right[i] *= factor;
        for (j = 0; j < p; ++j) {
            sums->cross[i][j] *= factor;
            sums->square[i][j] *= factor;
        }
    }
    sums->weight *= factor;
    sums->squares *= factor * factor;
}

#define MOST_WEIGHT PMF_R(524288.0) /* largest number of samples in a sum, 2^19 */
#define LONG_MEMORY PMF_SCALAR(0.999999) /* forgetting from which a sum may hold MOST_WEIGHT samples */

/* A sum of float32 cannot take a term below 2^-24 of its value. The weight of the past is therefore halved repeatedly.
 * Without forgetting, the memory is the last millions of samples. Only a sample with much information triggers the
 * halving, because at rest the sums do not grow. */
PMF_INLINE void make_room(const pmf_recursion_config_t *config, pmf_recursion_state_t *state, real_t first, real_t own,
                          uint32_t p)
{
    truth_t full = (state->sums.weight >= MOST_WEIGHT) & (first * first * state->sums.weight > own);
    uint32_t i;
    if (config->forgetting < LONG_MEMORY || !PMF_ANY(full)) {
        return;
    }
    PMF_WHERE(full, &state->sums, discount_sums(&state->sums, p, PMF_R(0.5)));
    for (i = 0; i < p; ++i) {
        state->peak[i] *= PMF_IF(full, PMF_R(0.5), PMF_R(1.0));
    }
    state->weight *= PMF_IF(full, PMF_R(0.5), PMF_R(1.0));
    state->innovation_square *= PMF_IF(full, PMF_R(0.5), PMF_R(1.0));
}
#endif

PMF_INLINE void accumulate(const pmf_recursion_config_t *config, pmf_recursion_state_t *state, const real_t *column,
                           uint32_t p, uint32_t instrumental)
{
    real_t fade = PMF_IF(state->frozen != 0U, PMF_R(1.0), PMF_ALIKE(config->forgetting));
    real_t f = PMF_IF(state->outdated != 0U, PMF_ALIKE(config->haste), memory_of(config, state, fade));
    state->outdated -= PMF_BIT(state->outdated != 0U, 1U);
#if PMF_ENDLESS
    make_room(config, state, column[instrumental != 0U ? p + 1U : 0U],
              instrumental != 0U ? state->sums.square[0][0] : state->sums.cross[0][0], p);
#endif
    add_sample(&state->sums, f, column, p, instrumental,
               state->started <= config->residual_updates); /* unused after this point */
    state->mass = fade * state->mass + (PMF_R(1.0) - fade);
    state->updates += PMF_BIT(state->updates < SATURATED, 1U);
}

#endif
