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
/* An export has the code of one scheme of forgetting. */
#ifdef PMF_SCHEME
#define SCHEME(config) PMF_SCHEME
#else
#define SCHEME(config) ((config)->scheme)
#endif

#define SPED_UP 1U
#define SLOWED_DOWN 2U

#define LARGER(a, b) PMF_IF((a) > (b), a, b)

/* Directional forgetting (Cao and Schwartz 2000): W - (1 - f) W phi phi^T W / (phi^T W phi). Directions without
 * information in phi are not forgotten, so that nothing winds up and no regularisation is needed. */
PMF_INLINE void forget_direction(const pmf_recursion_config_t *config, pmf_recursion_state_t *state, const real_t *phi,
                                 uint32_t p)
{
    real_t along[N], size = PMF_R(0.0);
    truth_t where;
    uint32_t i, j;
    for (i = 0; i < p; ++i) {
        along[i] = PMF_R(0.0);
        for (j = 0; j < p; ++j) {
            along[i] += (j > i ? state->sums.cross[j][i] : state->sums.cross[i][j]) * phi[j];
        }
        size += along[i] * phi[i];
    }
    where = (state->started != 0U) & (size > TINY);
    for (i = 0; i < p && PMF_ANY(where); ++i) {
        real_t part = (PMF_R(1.0) - config->forgetting) * along[i] / size;
        for (j = 0; j <= i; ++j) {
            real_t less = state->sums.cross[i][j] - part * along[j];
            if (i == j) { /* the form is negative after rounding, or in a foreign state that is no sum of squares */
                less = PMF_IF(less > PMF_R(0.0), less, PMF_R(0.0));
            }
            state->sums.cross[i][j] = PMF_IF(where, less, state->sums.cross[i][j]);
        }
    }
}

/* With directional forgetting a sample loses the fraction 1 - f of the information in one of p directions, on average
 * (1 - f) / p in each. */
PMF_INLINE scalar_t directions(const pmf_recursion_config_t *config)
{
    (void)config; /* an export has scheme and number of parameters as constants */
    return SCHEME(config) == PMF_DIRECTIONAL ? (scalar_t)PARAMETERS(config) : PMF_SCALAR(1.0);
}

PMF_INLINE void forget_weight(const pmf_recursion_config_t *config, pmf_recursion_state_t *state)
{
    scalar_t kept = PMF_SCALAR(1.0) - (PMF_SCALAR(1.0) - config->forgetting) / directions(config);
    state->sums.weight *= kept;
    state->sums.squares *= kept * kept;
}

#if PMF_WITH_SEPARATE
/* Forget by parameter (Saelid and Foss 1983). P becomes D^-1 P D^-1, so that the information R and its sums become D R
 * D. Returns the remaining weight of the past. */
PMF_INLINE real_t forget_separately(const pmf_recursion_config_t *config, pmf_recursion_state_t *state, real_t f,
                                    uint32_t p, uint32_t instrumental)
{
    truth_t where = (state->started != 0U) & (state->frozen == 0U), outdated = state->outdated != 0U;
    uint32_t i, j;
    for (i = 0; i < p; ++i) {
        for (j = 0; j < (instrumental != 0U ? p : i + 1U); ++j) {
            scalar_t keep = config->keep[i] * config->keep[j], hasty = keep * keep * keep * keep;
            real_t factor = PMF_IF(outdated, PMF_ALIKE(hasty * hasty), PMF_ALIKE(keep));
            factor = PMF_IF(where, factor, PMF_R(1.0));
            state->sums.cross[i][j] *= factor;
            if (instrumental != 0U) {
                state->sums.square[i][j] *= factor;
            }
        }
    }
    state->sums.weight *= PMF_IF(where, PMF_ALIKE(config->forgetting), PMF_R(1.0));
    state->sums.squares *= PMF_IF(where, PMF_ALIKE(config->forgetting * config->forgetting), PMF_R(1.0));
    return PMF_IF(where, PMF_R(1.0), f);
}
#endif

/* Return the weight of the past at the next sample. With constant trace, the weight drops by the fraction by which the
 * last sample lowered P, but at most by twice the normal forgetting. Motions that excite the axis are forgotten at
 * least normally, so that the information of larger motions does not stay for ever. */
PMF_INLINE real_t weight_of_past(const pmf_recursion_config_t *config, const pmf_recursion_state_t *state)
{
    real_t least = PMF_ALIKE(config->forgetting * config->forgetting), weight = PMF_ALIKE(config->forgetting);
    if (SCHEME(config) == PMF_DIRECTIONAL || SCHEME(config) == PMF_WINDOW) {
        return PMF_R(1.0);
    }
    if (SCHEME(config) == PMF_CONSTANT_TRACE) {
        truth_t known = state->trace > PMF_R(0.0), renewed = PMF_NOT(known) & (state->since < state->updates);
        real_t part = PMF_IF(known, LARGER(state->trace, least), PMF_R(1.0));
        weight = PMF_IF((state->excited != 0U) & (known | renewed), weight, PMF_R(1.0));
        weight = PMF_IF(part < weight, part, weight);
    }
    return PMF_IF(state->frozen != 0U, PMF_R(1.0), weight);
}

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

#if PMF_WINDOW_BLOCKS > 0
static void sum_window(pmf_recursion_state_t *state, uint32_t p)
{
    uint32_t i, j, block;
    pmf_clear(&state->sums, (uint32_t)sizeof state->sums);
    for (block = 0; block < PMF_WINDOW_BLOCKS; ++block) {
        const pmf_sums_t *part = &state->window[block];
        for (i = 0; i < p; ++i) {
            for (j = 0; j < p; ++j) {
                state->sums.cross[i][j] += part->cross[i][j];
                state->sums.square[i][j] += part->square[i][j];
            }
            state->sums.right[i] += part->right[i];
        }
        state->sums.weight += part->weight;
        state->sums.squares += part->squares;
    }
}

/* Remove the oldest block at once and compute the sums again, so that no rounding stays. */
static void slide_window(const pmf_recursion_config_t *config, pmf_recursion_state_t *state, const real_t *column)
{
    add_sample(&state->window[state->window_block], PMF_R(1.0), column, config->n_parameters, config->instrumental, 1);
    state->window_updates += 1U;
    if (state->window_updates >= config->window_block && state->frozen == 0U) {
        state->window_updates = 0U;
        state->window_block = state->window_block + 1U < PMF_WINDOW_BLOCKS ? state->window_block + 1U : 0U;
        pmf_clear(&state->window[state->window_block], (uint32_t)sizeof state->window[0]);
        sum_window(state, config->n_parameters);
    }
}
#endif

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

#endif

#if PMF_ENDLESS
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
    if (SCHEME(config) != PMF_EXPONENTIAL || config->forgetting < LONG_MEMORY || !PMF_ANY(full)) {
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
    real_t fade = weight_of_past(config, state), f = memory_of(config, state, fade);
    if (SCHEME(config) != PMF_EXPONENTIAL && SCHEME(config) != PMF_SEPARATE) {
        fade = PMF_ALIKE(config->forgetting);
    }
    if (SCHEME(config) != PMF_WINDOW && SCHEME(config) != PMF_SEPARATE) {
        f = PMF_IF(state->outdated != 0U, PMF_ALIKE(config->haste), f);
    }
#if PMF_WITH_SEPARATE
    if (SCHEME(config) == PMF_SEPARATE) {
        f = forget_separately(config, state, f, p, instrumental);
    }
#endif
    if (SCHEME(config) == PMF_CONSTANT_TRACE) { /* the trace belongs to another motion */
        state->trace = PMF_IF(state->outdated != 0U, PMF_R(0.0), state->trace);
        state->since = PMF_IF(state->outdated != 0U, PMF_W(0), state->since + PMF_BIT(state->since < SATURATED, 1U));
    }
    state->outdated -= PMF_BIT(state->outdated != 0U, 1U);
    if (SCHEME(config) == PMF_DIRECTIONAL) {
        fade = PMF_R(1.0);
        if (PMF_ANY(state->started != 0U)) {
            forget_direction(config, state, column, p);
        }
        forget_weight(config, state);
    }
#if PMF_ENDLESS
    make_room(config, state, column[instrumental != 0U ? p + 1U : 0U],
              instrumental != 0U ? state->sums.square[0][0] : state->sums.cross[0][0], p);
#endif
    add_sample(&state->sums, f, column, p, instrumental,
               state->started <= config->residual_updates); /* unused after this point */
#if PMF_WINDOW_BLOCKS > 0
    if (SCHEME(config) == PMF_WINDOW) {
        slide_window(config, state, column);
    }
#endif
    state->mass = fade * state->mass + (PMF_R(1.0) - fade);
    state->updates += PMF_BIT(state->updates < SATURATED, 1U);
}

/* Constant trace (Goodwin and Sin 1984, section 3.3) keeps the trace of P from the end of the first memory, or from the
 * end of the first memory of smaller motions. Each parameter counts in its own units. */
static void note_trace(const pmf_recursion_config_t *config, pmf_recursion_state_t *state, truth_t where,
                       whole_t status)
{
    const real_t *factor = state->estimate.variance_factor;
    real_t sum = PMF_R(0.0), memories = PMF_TO_REAL(state->since) * (PMF_R(1.0) - config->forgetting);
    truth_t first = PMF_NOT(state->trace > PMF_R(0.0));
    uint32_t i;
    where = where & PMF_NOT(first & ((memories < PMF_R(1.0)) | (status != 0U)));
    if (!PMF_ANY(where)) {
        return;
    }
    for (i = 0; i < PARAMETERS(config); ++i) {
        state->reference[i] = PMF_IF(where & first, factor[i], state->reference[i]);
        sum += factor[i] / (state->reference[i] + TINY);
    }
    state->trace = PMF_IF(where, sum / (scalar_t)PARAMETERS(config), state->trace);
}

#endif
