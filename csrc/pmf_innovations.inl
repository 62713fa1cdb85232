/* Statistics of innovations: their variance, the inflation of standard errors by their colour, and the check of the
 * model. Only pmf_recursion.c includes this file. SPDX-License-Identifier: Apache-2.0 */

static const uint32_t MIN_BLOCKS = 8U;
static const uint32_t SKIPPED_INNOVATIONS = 4U; /* first innovations, which do not show the noise yet */
static const uint32_t JUDGED = 16U; /* updates between two verdicts on the model (a power of two), between two looks */
static const scalar_t NEGLIGIBLE = PMF_SCALAR(1e-6); /* part of the target's mean square that may stay unexplained */

/* Sum the innovations of a stretch of samples, and keep the sums of the last stretch. */
static void note_unexplained(const pmf_recursion_config_t *config, pmf_recursion_state_t *state, truth_t where,
                             real_t target)
{
    real_t square = state->estimate.innovation * state->estimate.innovation;
    truth_t ends = where & PMF_NOT(state->check.weight < config->check_samples);
    if (PMF_ANY(ends)) {
        state->check_before.weight = PMF_IF(ends, state->check.weight, state->check_before.weight);
        state->check_before.innovation = PMF_IF(ends, state->check.innovation, state->check_before.innovation);
        state->check_before.target = PMF_IF(ends, state->check.target, state->check_before.target);
        PMF_WHERE(ends, &state->check, pmf_clear(&state->check, (uint32_t)sizeof state->check));
    }
    state->check.weight = PMF_IF(where, state->check.weight + PMF_R(1.0), state->check.weight);
    state->check.innovation = PMF_IF(where, state->check.innovation + square, state->check.innovation);
    state->check.target = PMF_IF(where, state->check.target + target * target, state->check.target);
}

/* Check whether the innovations exceed the known noise and the standard errors. Only the last two stretches count, so
 * that even a large transient at the start is forgotten. */
static whole_t check_model(const pmf_recursion_config_t *config, pmf_recursion_state_t *state, truth_t where,
                           real_t target)
{
    const pmf_estimate_t *estimate = &state->estimate;
    const real_t *theta = estimate->theta;
    real_t explained = PMF_R(0.0), unsure = PMF_R(0.0), limit;
    truth_t judged, large;
    uint32_t i, j;
    if (!PMF_ANY(where)) {
        return PMF_W(0);
    }
    note_unexplained(config, state, where, target);
    judged = (state->updates & (JUDGED - 1U)) == PMF_LOOK / 2U;
    if (!PMF_ANY(judged)) {
        return PMF_IF(where, state->unmodelled, PMF_W(0));
    }
    explained = PMF_ALIKE(config->target_power);
    for (i = 0; i < PARAMETERS(config); ++i) {
        if (PMF_PROCESS) {
            explained -= PMF_SCALAR(2.0) * theta[i] * config->target_noise[i];
        }
        for (j = 0; j < PARAMETERS(config); ++j) {
            explained += theta[i] * config->noise[i][j] * theta[j];
        }
        unsure += estimate->inflation[i]; /* mean of phi^T (covariance of theta) phi, in innovation variances */
    }
    explained += estimate->innovation_variance * unsure / state->sums.weight;
    limit = config->unexplained * explained * (state->check.weight + state->check_before.weight) +
            NEGLIGIBLE * (state->check.target + state->check_before.target);
    large =
        (state->check_before.weight > PMF_R(0.0)) & (state->check.innovation + state->check_before.innovation > limit);
    state->unmodelled = PMF_IF(where & judged, PMF_BIT(large, PMF_UNMODELLED), state->unmodelled);
    return PMF_IF(where, state->unmodelled, PMF_W(0));
}

PMF_INLINE void note_innovation(const pmf_recursion_config_t *config, pmf_recursion_state_t *state, truth_t where,
                                const real_t *zeta, uint32_t p)
{
    pmf_estimate_t *estimate = &state->estimate;
    real_t square = estimate->innovation * estimate->innovation, share = PMF_R(1.0);
    uint32_t i;
    if (PMF_WITH_AUXILIARY && config->growing != 0U) {
        share = PMF_R(0.0);
        for (i = 0; i < p; ++i) {
            share += zeta[i] * zeta[i] * estimate->variance_factor[i];
        }
    }
    real_t f = memory_of(config, state, PMF_ALIKE(config->forgetting)); /* the sums forget like the samples */
    where = where & (state->started > SKIPPED_INNOVATIONS) & (state->frozen == 0U);
    if (PMF_ANY(where)) {
        state->weight = PMF_IF(where, f * state->weight + share, state->weight);
        state->innovation_square =
            PMF_IF(where, f * state->innovation_square + share * square, state->innovation_square);
    }
}

/* Return the variance of the constant plus `lift` times the lowest coefficient, over the variance of the innovations.
 * The variance is a sum of squares here, because entries of P would give it as a small difference. */
PMF_SELDOM real_t lifted_factor(const pmf_recursion_config_t *config, pmf_recursion_state_t *state)
{
    real_t x[N], sum = PMF_R(0.0);
    uint32_t i;
    for (i = 0; i < PARAMETERS(config); ++i) {
        x[i] = PMF_R(0.0);
    }
    x[config->constant] = PMF_R(1.0);
    x[config->lowest] = PMF_LIFT(state);
    forward(PARAMETERS(config), state->factor, x);
    for (i = 0; i < PARAMETERS(config); ++i) {
        sum += x[i] * x[i] * state->inverse_pivot[i];
    }
    return PMF_IF(sum - sum == PMF_R(0.0), sum, PMF_UNKNOWN);
}

/* Compare the spread of theta by blocks of innovations to the spread by white innovations (batch means). With weights
 * w, the covariance of theta is P (sum w^2) S P, where S is the long-run covariance of the scores. White innovations
 * with equal weights give P times their variance. Blocks missing from MIN_BLOCKS count as blocks of equal innovations
 * over the memory of the filters. `move` is a block's sum after the gain. */
static void note_block(const pmf_recursion_config_t *config, pmf_recursion_state_t *state, truth_t where,
                       real_t move[N])
{
    real_t share = state->sums.squares / PMF_TO_REAL(state->block_updates);
    truth_t few = state->blocks < MIN_BLOCKS;
    real_t blocks;
    uint32_t i;
    state->blocks += PMF_BIT(where & (state->blocks < PMF_BLOCK_MEMORY), 1U);
    blocks = PMF_IF(few, PMF_ALIKE((scalar_t)MIN_BLOCKS), PMF_TO_REAL(state->blocks));
    for (i = 0; i < PARAMETERS(config); ++i) {
        real_t white = state->estimate.variance_factor[i] * state->estimate.innovation_variance;
        real_t *inflation = &state->estimate.inflation[i], change;
        if (PMF_PROCESS && i == config->constant) { /* the constant in the form that the user reads */
            white = lifted_factor(config, state) * state->estimate.innovation_variance;
            move[i] += PMF_LIFT(state) * move[config->lowest];
        }
        change = move[i] * move[i] * share / white - PMF_IF(few, PMF_ALIKE(config->correlated), *inflation);
        /* infinite values and NaN would stay for ever */
        *inflation = PMF_IF(where & (change - change == PMF_R(0.0)), *inflation + change / blocks, *inflation);
    }
}

PMF_INLINE void solve(pmf_recursion_state_t *state, uint32_t p, real_t move[N])
{
    uint32_t i;
    forward(p, state->factor, move);
    for (i = 0; i < p; ++i) {
        move[i] *= state->inverse_pivot[i];
    }
    backward(p, state->factor, move);
}

/* Compare the effect of a block on theta to the effect of white innovations, at the end of the block. */
PMF_SELDOM void end_block(const pmf_recursion_config_t *config, pmf_recursion_state_t *state, truth_t where, uint32_t p,
                          uint32_t instrumental, projection_t *projection)
{
    real_t move[N];
    uint32_t i;
    for (i = 0; i < p; ++i) {
        move[i] = state->score[i];
        state->score[i] = PMF_IF(where, PMF_R(0.0), state->score[i]);
    }
    if (instrumental != 0U) {
        project(p, projection, move);
    }
    solve(state, p, move);
    note_block(config, state, where, move);
    state->block_updates = PMF_IF(where, PMF_W(0), state->block_updates);
}

/* Return whether columns show the errors of misread counts. */
PMF_INLINE int misreads(const pmf_recursion_config_t *config)
{
    return PMF_WITH_MISREAD && config->misread_column != 0U;
}

/* Part of a parameter's information that is noise, above which least squares know nothing. */
static const scalar_t MOST_NOISE = PMF_SCALAR(0.9);
/* Ratio of noise to information above which instruments know nothing: a correlation of 0.2 between instruments and
 * noise would change the parameter by as much as itself, and control through the encoder causes such a correlation. */
static const scalar_t MOST_HIDDEN = PMF_SCALAR(25.0);

/* Return the variance of `factor` times an error over that of white innovations, 0 if it is no number. */
PMF_INLINE real_t over_white(real_t error, real_t factor, real_t certainty)
{
    real_t ratio = factor * error * (error * certainty); /* no square, which might overflow in float32 */
    return PMF_IF(ratio - ratio == PMF_R(0.0), ratio, PMF_R(0.0));
}

/* Gather the errors of misread counts before the gain. Between two solutions the errors come from the same counts, so
 * that they keep their signs. `f` is the weight of the past. */
PMF_INLINE void gather_misread(const pmf_recursion_config_t *config, pmf_recursion_state_t *state, truth_t where,
                               real_t f, const real_t *error, const real_t *zeta, uint32_t p)
{
    real_t sum = -error[config->n_misread];
    uint32_t i;
    for (i = 0; i < config->n_misread; ++i) {
        sum += state->estimate.theta[config->misread_index[i]] * error[i];
    }
    for (i = 0; i < p; ++i) {
        state->strayed[i] = PMF_IF(where, f * state->strayed[i] + zeta[i] * sum, PMF_R(0.0));
        state->misread[i] *= f;
    }
}

/* Add the largest effect of misread counts to the standard errors. An error e of an equation moves theta by P zeta e.
 * The signs of the errors are unknown, so that the sizes add up. Over the diagonal of P the sums are discounted like
 * information. */
PMF_INLINE void note_misread(const pmf_recursion_config_t *config, pmf_recursion_state_t *state, truth_t where,
                             uint32_t p, uint32_t instrumental, projection_t *projection)
{
    real_t move[N], certainty = PMF_R(1.0) / state->estimate.innovation_variance;
    uint32_t i;
    (void)config;
    for (i = 0; i < p; ++i) {
        move[i] = state->strayed[i];
    }
    if (instrumental != 0U) {
        project(p, projection, move);
    }
    solve(state, p, move);
    for (i = 0; i < p; ++i) {
        real_t factor = state->estimate.variance_factor[i];
        real_t now = state->misread[i] + PMF_SIZE(move[i]) / factor;
        state->misread[i] = PMF_IF(where & (now - now == PMF_R(0.0)), now, state->misread[i]);
        state->estimate.inflation[i] += over_white(state->misread[i], factor, certainty);
    }
}

/* Return poor excitation unless the mass, which is positive, differs from zero by three standard errors (factor 9). */
PMF_INLINE whole_t judge_mass(const pmf_recursion_config_t *config, const pmf_estimate_t *estimate)
{
    uint32_t i = config->leading;
    real_t mass = estimate->theta[i], most = PMF_R(9.0) * estimate->variance_factor[i] * estimate->innovation_variance;
    return PMF_BIT(PMF_NOT(mass * PMF_SIZE(mass) > most * estimate->inflation[i]), PMF_POOR_EXCITATION);
}

/* Return the largest ratio of the known noise in a parameter's products to the information on the parameter. */
PMF_INLINE real_t noise_ratio(const pmf_recursion_config_t *config, const pmf_recursion_state_t *state, uint32_t p)
{
    real_t most = PMF_R(0.0);
    uint32_t i;
    for (i = 0; i < p; ++i) {
        real_t ratio = state->estimate.variance_factor[i] * state->sums.weight * config->noise[i][i];
        most = PMF_IF(ratio > most, ratio, most);
    }
    return most;
}

/* Add the bias from the known noise to the standard errors of least squares. The noise moves theta by -P (weight noise)
 * theta, where theta and P hold for the information without the noise. */
PMF_INLINE void add_bias(const pmf_recursion_config_t *config, pmf_recursion_state_t *state, real_t part, uint32_t p)
{
    real_t move[N];
    uint32_t i, j;
    for (i = 0; i < p; ++i) {
        move[i] = PMF_R(0.0);
        for (j = 0; j < p; ++j) {
            move[i] += state->sums.weight * config->noise[i][j] * state->estimate.theta[j];
        }
    }
    solve(state, p, move);
    part = PMF_R(1.0) - PMF_IF(part < MOST_NOISE, part, MOST_NOISE);
    part = PMF_R(1.0) / (part * part * state->estimate.innovation_variance);
    for (i = 0; i < p; ++i) {
        real_t factor = state->estimate.variance_factor[i];
        state->estimate.inflation[i] += over_white(move[i] / factor, factor, part);
    }
}

/* Include the known noise in the standard errors. Returns poor excitation if the noise hides the motion. */
PMF_INLINE whole_t note_bias(const pmf_recursion_config_t *config, pmf_recursion_state_t *state, uint32_t p,
                             uint32_t instrumental)
{
    real_t ratio = noise_ratio(config, state, p);
    if (instrumental != 0U) {
        return PMF_BIT(ratio > MOST_HIDDEN, PMF_POOR_EXCITATION);
    }
    add_bias(config, state, ratio, p);
    return PMF_BIT(ratio > MOST_NOISE, PMF_POOR_EXCITATION);
}

/* Accumulate the innovations of a block. */
PMF_INLINE void note_score(const pmf_recursion_config_t *config, pmf_recursion_state_t *state, truth_t where,
                           truth_t young, uint32_t p)
{
    uint32_t i;
    for (i = 0; i < p; ++i) {
        state->score[i] = PMF_IF(where, state->score[i] + state->gathered[i], state->score[i]);
    }
    state->block_updates += PMF_IF(where, PMF_IF(young, PMF_W(1), PMF_W(config->every)), PMF_W(0));
}
