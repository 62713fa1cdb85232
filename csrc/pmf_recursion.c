/* Recursive least squares and recursive instrumental variables in information form.
 * SPDX-License-Identifier: Apache-2.0
 *
 * The recursion keeps the sums that define the estimate, discounted by the forgetting factor,
 *     W = sum zeta phi^T,  Z = sum zeta zeta^T,  v = sum zeta z          (least squares: zeta = phi, Z = W)
 * with R = W^T Z^-1 W + regularisation. Sums cannot lose their symmetry, and cannot wind up because W decays without
 * excitation. The regularisation is a small fraction of the largest information so far
 * (Levenberg-Marquardt recursive least squares, Ljung and Soderstrom 1983). The regularisation slows theta in hardly
 * excited directions. If a direction has only the regularisation, theta is held and the status says so. With forgetting
 * = 1 no regularisation is used, and theta equals the batch solution.
 *
 * Every sample enters W and Z, and g = v - W theta, which grows by zeta (z - phi^T theta). The factors, theta and all
 * verdicts are needed less often, and are the largest part of the work. `every` samples have one solution, theta +=
 * R^-1 W^T Z^-1 g. Between two solutions theta, P and the verdicts stay. Without the regularisation every solution
 * gives exactly theta = W^-1 v.
 *
 * Every loop has a fixed number of turns, because n_parameters is a constant of the configuration. */
#include "pmf_internal.h"

#include "pmf_algebra.inl"
#include "pmf_forgetting.inl"
#include "pmf_innovations.inl"

static const scalar_t POOR = PMF_SCALAR(50.0); /* information below POOR times the regularisation is called poor */
static const scalar_t FREEZE = PMF_SCALAR(1e-3); /* information below FREEZE times the regularisation is kept */
static const uint32_t FEW = 8U; /* solutions in a memory, below which each sample needs one */
static const scalar_t LEAST_CLEAN = PMF_SCALAR(0.02); /* part of a column's information that remains without noise */

/* Subtract the apparent information of the known noise. If hardly any information is left, excitation is poor, and a
 * fraction is kept so that P stays positive. Before the first estimate nothing is subtracted, because the noise may
 * exceed the information. */
PMF_INLINE whole_t subtract_noise(const pmf_recursion_config_t *config, const pmf_recursion_state_t *state, uint32_t p,
                                  real_t information[N][N])
{
    whole_t poor = PMF_W(0);
    real_t weight = PMF_IF(state->updates < config->min_updates, PMF_R(0.0), state->sums.weight);
    uint32_t i, j;
    for (i = 0; i < p; ++i) {
        real_t least = LEAST_CLEAN * information[i][i];
        for (j = 0; j <= i; ++j) {
            information[i][j] -= weight * config->noise[i][j];
        }
        poor |= PMF_BIT(information[i][i] < least, PMF_POOR_EXCITATION);
        information[i][i] = PMF_IF(information[i][i] < least, least, information[i][i]);
    }
    return poor;
}

/* Add the regularisation, and note whether information is left to forget. */
PMF_INLINE void regularise(const pmf_recursion_config_t *config, pmf_recursion_state_t *state, uint32_t p,
                           real_t information[N][N])
{
    uint32_t i;
    state->frozen = PMF_W(1);
    for (i = 0; i < p; ++i) {
        real_t now = information[i][i];
        state->peak[i] = PMF_IF(now > state->peak[i], now, state->peak[i]);
        state->frozen &= PMF_BIT(PMF_NOT(now > FREEZE * config->regularization * state->peak[i]), 1U);
        information[i][i] = now + state->mass * config->regularization * state->peak[i];
    }
}

/* Compute the diagonal of P = (L D L^T)^-1, and flag a parameter whose own information hardly exceeds the
 * regularisation. */
PMF_INLINE whole_t judge(const pmf_recursion_config_t *config, pmf_recursion_state_t *state, uint32_t p)
{
    real_t threshold = POOR * state->mass * config->regularization;
    whole_t poor = PMF_W(0);
    uint32_t i, j, k;
    for (i = 0; i < p; ++i) {
        real_t unit[N], sum = state->inverse_pivot[i];
        unit[i] = PMF_R(1.0);
        for (j = i + 1U; j < p; ++j) {
            unit[j] = PMF_R(0.0);
            for (k = i; k < j; ++k) {
                unit[j] -= state->factor[j][k] * unit[k];
            }
            sum += unit[j] * unit[j] * state->inverse_pivot[j];
        }
        state->estimate.variance_factor[i] = sum;
    }
    for (i = 0; i < p; ++i) {
        real_t part = state->estimate.variance_factor[i] * threshold * state->peak[i];
        poor |= PMF_BIT((PMF_R(1.0) < part) | (state->peak[i] <= PMF_TINY), PMF_POOR_EXCITATION);
    }
    return poor;
}

/* Gather the move of theta before the gain. `f` is the weight of the past. */
PMF_INLINE void gather_move(const pmf_recursion_config_t *config, pmf_recursion_state_t *state, real_t f,
                            const real_t *zeta, uint32_t p)
{
    uint32_t i, j;
    for (i = 0; i < p; ++i) {
        real_t sum = zeta[i] * state->estimate.innovation;
        if (config->compensated != 0U) {
            if (PMF_PROCESS) {
                sum -= config->target_noise[i];
            }
            for (j = 0; j < p; ++j) {
                sum += config->noise[i][j] * state->estimate.theta[j];
            }
        }
        state->gathered[i] = f * state->gathered[i] + sum;
        state->rest[i] *= f;
    }
}

/* Begin the next sums after a move. A young estimate keeps the rest of v - W theta, so that the next solution removes
 * the rounding of this one. Later the innovations alone move theta, so that rounding of the sums has no effect. */
PMF_INLINE void begin_gathering(const pmf_recursion_config_t *config, pmf_recursion_state_t *state, truth_t moves,
                                const real_t *move, uint32_t p, uint32_t instrumental)
{
    truth_t young = state->started <= config->residual_updates, moved = young & moves;
    uint32_t i, j;
    for (i = 0; i < p; ++i) {
        real_t left = state->gathered[i] + state->rest[i];
        for (j = 0; j < p && PMF_ANY(moved); ++j) {
            real_t own = instrumental == 0U && j > i ? state->sums.cross[j][i] : state->sums.cross[i][j];
            if (config->compensated != 0U) {
                own -= state->sums.weight * config->noise[i][j];
            }
            left = PMF_IF(moved, left - own * move[j], left);
        }
        state->rest[i] = PMF_IF(young, left, PMF_R(0.0));
        state->gathered[i] = PMF_R(0.0);
        if (PMF_WITH_MISREAD) {
            state->strayed[i] = PMF_R(0.0);
        }
    }
}

#if PMF_WITH_PROCESS
PMF_API void pmf_lift(const pmf_config_t *config, pmf_state_t *state)
{
    const pmf_recursion_config_t *recursion = &config->direct;
    const pmf_estimate_t *estimate = &state->direct.estimate;
    pmf_estimate_t *lifted = PMF_LIFTED(state);
    real_t constant =
        estimate->theta[recursion->constant] + PMF_LIFT(&state->direct) * estimate->theta[recursion->lowest];
    uint32_t i;
    for (i = 0; i < PARAMETERS(recursion); ++i) {
        lifted->theta[i] = estimate->theta[i];
        lifted->variance_factor[i] = estimate->variance_factor[i];
        lifted->inflation[i] = estimate->inflation[i];
    }
    lifted->innovation = estimate->innovation;
    lifted->innovation_variance = estimate->innovation_variance;
    lifted->theta[recursion->constant] =
        PMF_IF(constant - constant == PMF_R(0.0), constant, estimate->theta[recursion->constant]);
    lifted->variance_factor[recursion->constant] = lifted_factor(recursion, &state->direct);
}
#endif

/* Solve for theta, and judge the solution. `looks` says when to compare the sizes of motions, and `young` means that
 * every sample has a solution. Returns status bits without the verdict on the model. */
PMF_INLINE whole_t solution(const pmf_recursion_config_t *config, pmf_recursion_state_t *state, const real_t *column,
                            truth_t looks, truth_t young, uint32_t p, uint32_t instrumental)
{
    real_t information[N][N], move[N], pivot, own;
    projection_t projection;
    whole_t status, compensated = PMF_W(0), hidden = PMF_W(0);
    truth_t waits = state->started == 0U, starts = waits, moves, scored, ends;
    uint32_t i, j;
    for (i = 0; i < p; ++i) {
        if (misreads(config) != 0) {
            state->estimate.inflation[i] = state->spread[i];
        }
        move[i] = state->gathered[i] + state->rest[i];
    }
    if (instrumental != 0U) {
        project_information(state, p, &projection, information);
        project(p, &projection, move);
    } else {
        for (i = 0; i < p; ++i) {
            for (j = 0; j <= i; ++j) {
                information[i][j] = state->sums.cross[i][j];
            }
        }
        if (config->compensated != 0U) {
            compensated = subtract_noise(config, state, p, information);
        }
    }
    if (config->half_memory != 0U && PMF_ANY(looks)) {
        compare_sizes(config, state, column[config->leading], looks, p, information[config->leading][config->leading]);
    }
    regularise(config, state, p, information);
    factorise(p, information, state->factor, state->inverse_pivot);
    status = judge(config, state, p) | compensated;
    if (PMF_ANY(waits)) {
        pivot = smallest_pivot(p, information, state->inverse_pivot);
        if (instrumental != 0U) {
            own = smallest_pivot(p, state->sums.square, projection.inverse);
            pivot = PMF_IF(own < pivot, own, pivot);
        }
        waits = waits & ((state->updates < config->min_updates) | PMF_NOT(pivot > config->pivot));
        starts = starts & PMF_NOT(waits);
        if (PMF_ALL(waits)) {
            begin_gathering(config, state, PMF_NOT(waits), move, p, instrumental);
            return PMF_W(PMF_STARTING | PMF_POOR_EXCITATION);
        }
        for (i = 0; i < p; ++i) {
            state->estimate.inflation[i] = PMF_IF(starts, PMF_ALIKE(config->correlated), state->estimate.inflation[i]);
        }
        state->started = PMF_IF(starts, PMF_W(1), state->started);
    }
    /* noise alone must not move theta slowly */
    moves = PMF_NOT(waits) & ((status == 0U) | starts);
    if (PMF_ANY(moves)) {
        solve(state, p, move);
        for (i = 0; i < p; ++i) {
            state->estimate.theta[i] = PMF_IF(moves, state->estimate.theta[i] + move[i], state->estimate.theta[i]);
        }
    }
    scored = PMF_NOT(waits) & (state->weight > PMF_R(0.0));
    state->estimate.innovation_variance =
        PMF_IF(scored, state->innovation_square / state->weight, state->estimate.innovation_variance);
    scored = scored & (status == 0U);
    if (config->block > 0U && PMF_ANY(scored)) {
        note_score(config, state, scored, young, p);
        ends = scored & (state->block_updates >= config->block);
        if (PMF_ANY(ends)) {
            end_block(config, state, ends, p, instrumental, &projection);
        }
    }
    if (misreads(config) != 0) {
        for (i = 0; i < p; ++i) {
            state->spread[i] = state->estimate.inflation[i];
        }
        note_misread(config, state, PMF_NOT(waits), p, instrumental, &projection);
        hidden = note_bias(config, state, p, instrumental);
        hidden |= judge_mass(config, &state->estimate);
    }
    if (instrumental != 0U) {
        status |= PMF_BIT(status != 0U, PMF_COMPENSATION_HELD);
    }
    begin_gathering(config, state, moves, move, p, instrumental);
    return PMF_IF(waits, PMF_W(PMF_STARTING | PMF_POOR_EXCITATION), status | hidden);
}

PMF_INLINE whole_t update(const pmf_recursion_config_t *config, pmf_recursion_state_t *state, const real_t *column,
                          truth_t due, uint32_t p, uint32_t instrumental)
{
    const real_t *zeta = instrumental != 0U ? &column[p + 1U] : column;
    whole_t unmodelled = PMF_W(0);
    truth_t known = state->started != 0U, young;
    real_t f;
    uint32_t i;
    state->estimate.innovation = column[p];
    for (i = 0; i < p; ++i) {
        state->estimate.innovation -= column[i] * state->estimate.theta[i];
    }
    f = accumulate(config, state, column, p, instrumental);
    gather_move(config, state, f, zeta, p);
    if (misreads(config) != 0) {
        gather_misread(config, state, known, f, &column[config->misread_column], zeta, p);
    }
    state->started += PMF_BIT(known & (state->started < SATURATED), 1U);
    note_innovation(config, state, known, zeta, p);
    if (config->unexplained > PMF_SCALAR(0.0)) {
        unmodelled = check_model(config, state, known & (state->started > SKIPPED_INNOVATIONS), column[p]);
    }
    young = state->sums.weight < (scalar_t)(FEW * config->every);
    PMF_WHERE(due | young, state, state->verdict = solution(config, state, column, due, young, p, instrumental));
    known = state->started != 0U;
    state->estimate.innovation = PMF_IF(known, state->estimate.innovation, PMF_R(0.0));
    return PMF_IF(known, state->verdict | unmodelled, PMF_W(PMF_STARTING | PMF_POOR_EXCITATION));
}

/* Check the sums as well, because an overflow would show in theta much later, or never. The check adds row by row, so
 * that no addition waits for all others. */
PMF_INLINE truth_t finite_state(const pmf_recursion_state_t *state, uint32_t p, uint32_t instrumental)
{
    real_t sum = state->innovation_square;
    uint32_t i, j;
    for (i = 0; i < p; ++i) {
        real_t row = state->estimate.theta[i] + state->estimate.variance_factor[i] + state->gathered[i];
        for (j = 0; j < (instrumental != 0U ? p : i + 1U); ++j) {
            row += state->sums.cross[i][j];
        }
        for (j = 0; j <= i && instrumental != 0U; ++j) {
            row += state->sums.square[i][j];
        }
        sum += row;
    }
    return sum - sum == PMF_R(0.0);
}

/* Return the status of the update, or PMF_RESET after an overflow. */
PMF_INLINE whole_t checked(const pmf_recursion_config_t *config, pmf_recursion_state_t *state, const real_t *column,
                           truth_t due, uint32_t p, uint32_t instrumental)
{
    whole_t status = update(config, state, column, due, p, instrumental);
    return PMF_IF(finite_state(state, p, instrumental), status, PMF_W(PMF_RESET | PMF_STARTING));
}

/* The step with a constant number of parameters. Loops unroll, and the bits stay. The code is split into functions,
 * because a compiler's time grows faster than the size of a function. An export with shapes has recursions of two
 * sizes. Both use loops, because code for every size would be twice the rest of the kernel. */
#if defined(PMF_PARAMETERS) || (PMF_MAX_SHAPES > 0 && PMF_LAYOUT != 0U)
#define SIZES(DO)
#elif PMF_MAX_PARAMETERS >= 8 && !defined(PMF_LANES)
#define SIZES(DO) DO(3, 0) DO(3, 1) DO(4, 0) DO(4, 1) DO(5, 0) DO(5, 1) DO(6, 0) DO(6, 1) DO(7, 0) DO(8, 0)
#else
#define SIZES(DO) DO(3, 0) DO(3, 1) DO(4, 0) DO(4, 1) DO(5, 0)
#endif
#define FIXED(p, instrumental)                                                                                         \
    PMF_APART whole_t checked_##p##_##instrumental(const pmf_recursion_config_t *config, pmf_recursion_state_t *state, \
                                                   const real_t *column, truth_t due)                                  \
    {                                                                                                                  \
        return checked(config, state, column, due, p##U, instrumental##U);                                             \
    }
#define CALL(p, instrumental) \
    case (p) * 2 + (instrumental): return checked_##p##_##instrumental(config, state, column, due);
SIZES(FIXED)

static whole_t dispatch(const pmf_recursion_config_t *config, pmf_recursion_state_t *state, const real_t *column,
                        truth_t due)
{
    switch (PARAMETERS(config) * 2U + INSTRUMENTAL(config)) {
        SIZES(CALL)
    default: return checked(config, state, column, due, PARAMETERS(config), INSTRUMENTAL(config));
    }
}

/* Forget everything except the last finite estimate. */
PMF_SELDOM void restart(pmf_recursion_state_t *state, const real_t theta[N], uint32_t p)
{
    uint32_t i;
    pmf_clear(state, (uint32_t)sizeof *state);
    for (i = 0; i < p; ++i) {
        state->estimate.theta[i] = theta[i];
    }
}

PMF_API whole_t pmf_recursion_step(const pmf_recursion_config_t *config, pmf_recursion_state_t *state,
                                   const real_t *column, truth_t due)
{
    uint32_t p = PARAMETERS(config), i;
    real_t theta[N];
    whole_t status;
    for (i = 0; i < p; ++i) {
        theta[i] = state->estimate.theta[i];
    }
    status = dispatch(config, state, &column[config->first_column], due);
    PMF_WHERE((status & PMF_RESET) != 0U, state, restart(state, theta, p));
    return status;
}
