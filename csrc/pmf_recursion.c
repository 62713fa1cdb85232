/* Recursive least squares and recursive instrumental variables in information form.
 * SPDX-License-Identifier: Apache-2.0
 *
 * Kept are the sums that define the estimate, discounted by the forgetting factor,
 *     W = sum zeta phi^T,  Z = sum zeta zeta^T,  v = sum zeta z          (least squares: zeta = phi, Z = W)
 * and theta is moved by  theta += R^-1 W^T Z^-1 zeta (z - phi^T theta),  R = W^T Z^-1 W + regularisation,
 * which without the regularisation is exactly theta = W^-1 v. Kept as sums, nothing can lose its symmetry or
 * wind up: without excitation W decays, and the regularisation, a small part of the largest information seen
 * (Levenberg-Marquardt recursive least squares, Ljung and Soderstrom 1983), slows theta in just those directions that
 * are hardly excited; where it is all there is in some direction, theta is held and the status says so. With
 * forgetting = 1 there is none, and theta equals the batch solution.
 *
 * Every loop has a fixed number of turns: n_parameters is a constant of the configuration.
 */
#include "pmf.h"

/* The loops unroll only where the number of parameters arrives as a constant. */
#if defined(__GNUC__)
#define PMF_INLINE static inline __attribute__((always_inline))
#else
#define PMF_INLINE static inline
#endif

#define N PMF_MAX_PARAMETERS
#define SATURATED 0xffffffffU

#ifdef PMF_FLOAT32
#define PIVOT_FLOOR PMF_R(1e-6)
#define TINY PMF_R(1e-30)
#else
#define PIVOT_FLOOR PMF_R(1e-14)
#define TINY PMF_R(1e-200)
#endif
#define POOR PMF_R(50.0)    /* information below POOR times the regularisation is called poor */
#define FREEZE PMF_R(1e-3)  /* and below FREEZE times it there is nothing left worth forgetting */
#define PEAK_LEAK PMF_R(0.01)
#define LEAST_CLEAN PMF_R(0.02) /* of a column's information */
#define BLOCK_MEMORY 100U
#define MIN_BLOCKS 8U
#define SKIPPED_INNOVATIONS 4U /* innovations of a fresh estimate say nothing of the noise */
#define NEGLIGIBLE PMF_R(1e-6) /* mean square part of the target that no model need explain */

/* Lower half of a symmetric matrix = L D L^T. */
PMF_INLINE void factorise(uint32_t p, real_t matrix[N][N], real_t lower[N][N], real_t inverse[N])
{
    real_t scaled[N];
    uint32_t i, j, k;
    for (i = 0; i < p; ++i) {
        real_t pivot = matrix[i][i], floor = PIVOT_FLOOR * matrix[i][i] + TINY;
        for (j = 0; j < i; ++j) {
            real_t sum = matrix[i][j];
            for (k = 0; k < j; ++k) {
                sum -= scaled[k] * lower[j][k];
            }
            scaled[j] = sum;
            lower[i][j] = sum * inverse[j];
            pivot -= sum * lower[i][j];
        }
        inverse[i] = PMF_R(1.0) / (pivot > floor ? pivot : floor); /* floor > 0: P is positive whatever comes */
    }
}

/* The smallest pivot relative to its diagonal entry. */
PMF_INLINE real_t smallest_pivot(uint32_t p, real_t matrix[N][N], const real_t inverse[N])
{
    real_t smallest = PMF_R(1.0), relative;
    uint32_t i;
    for (i = 0; i < p; ++i) {
        relative = matrix[i][i] > TINY ? PMF_R(1.0) / (inverse[i] * matrix[i][i]) : PMF_R(0.0);
        smallest = relative < smallest ? relative : smallest;
    }
    return smallest;
}

PMF_INLINE void forward(uint32_t p, real_t lower[N][N], real_t x[N])
{
    uint32_t i, j;
    for (i = 1; i < p; ++i) {
        for (j = 0; j < i; ++j) {
            x[i] -= lower[i][j] * x[j];
        }
    }
}

PMF_INLINE void backward(uint32_t p, real_t lower[N][N], real_t x[N])
{
    uint32_t i, j;
    for (i = p; i-- > 1U;) {
        for (j = 0; j < i; ++j) {
            x[j] -= lower[i][j] * x[i];
        }
    }
}

/* Directional forgetting (Cao and Schwartz 2000): W - (1 - f) W phi phi^T W / (phi^T W phi). What phi says nothing of is
 * not forgotten, so that there is nothing to wind up and no regularisation is needed. */
PMF_INLINE void forget_direction(const pmf_recursion_config_t *config, pmf_recursion_state_t *state, const real_t *phi,
                                 uint32_t p)
{
    real_t along[N], size = PMF_R(0.0);
    uint32_t i, j;
    for (i = 0; i < p; ++i) {
        along[i] = PMF_R(0.0);
        for (j = 0; j < p; ++j) {
            along[i] += (j > i ? state->sums.cross[j][i] : state->sums.cross[i][j]) * phi[j];
        }
        size += along[i] * phi[i];
    }
    if (size > TINY) {
        for (i = 0; i < p; ++i) {
            real_t part = (PMF_R(1.0) - config->forgetting) * along[i] / size;
            for (j = 0; j <= i; ++j) {
                state->sums.cross[i][j] -= part * along[j];
            }
        }
    }
}

/* Forgetting by parameter (Saelid and Foss 1983): P = D^-1 P D^-1, that is D R D for the information, and so for the sums
 * that it is made of. */
PMF_INLINE void forget_separately(const pmf_recursion_config_t *config, pmf_recursion_state_t *state, uint32_t p)
{
    uint32_t i, j;
    for (i = 0; i < p; ++i) {
        for (j = 0; j < p; ++j) {
            real_t factor = config->keep[i] * config->keep[j];
            state->sums.cross[i][j] *= factor;
            state->sums.square[i][j] *= factor;
        }
    }
    state->sums.weight *= config->forgetting;
}

/* Weight of the past at the next sample. With constant trace the part of P by which the last one had lowered it, but
 * never less than forgetting twice as fast. */
PMF_INLINE real_t weight_of_past(const pmf_recursion_config_t *config, const pmf_recursion_state_t *state)
{
    real_t least = config->forgetting * config->forgetting;
    if (state->frozen != 0U || config->scheme == PMF_DIRECTIONAL || config->scheme == PMF_WINDOW) {
        return PMF_R(1.0);
    }
    if (config->scheme != PMF_CONSTANT_TRACE) {
        return config->forgetting;
    }
    if (!(state->trace > PMF_R(0.0)) || state->trace > PMF_R(1.0)) {
        return PMF_R(1.0);
    }
    return state->trace > least ? state->trace : least;
}

PMF_INLINE void add_sample(pmf_sums_t *sums, real_t f, const real_t *column, uint32_t p, uint32_t instrumental,
                           uint32_t with_right)
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
        if (with_right != 0U) {
            sums->right[i] = f * sums->right[i] + zeta[i] * column[p];
        }
    }
    sums->weight = f * sums->weight + PMF_R(1.0);
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
    }
}

/* The oldest block goes at once and the sums are made anew: no rounding stays. */
static void slide_window(const pmf_recursion_config_t *config, pmf_recursion_state_t *state, const real_t *column)
{
    add_sample(&state->window[state->window_block], PMF_R(1.0), column, config->n_parameters, config->instrumental, 1U);
    state->window_updates += 1U;
    if (state->window_updates >= config->window_block && state->frozen == 0U) {
        state->window_updates = 0U;
        state->window_block = state->window_block + 1U < PMF_WINDOW_BLOCKS ? state->window_block + 1U : 0U;
        pmf_clear(&state->window[state->window_block], (uint32_t)sizeof state->window[0]);
        sum_window(state, config->n_parameters);
    }
}
#endif

PMF_INLINE void accumulate(const pmf_recursion_config_t *config, pmf_recursion_state_t *state,
                              const real_t *column, uint32_t p, uint32_t instrumental)
{
    real_t f = weight_of_past(config, state), fade = config->scheme == PMF_EXPONENTIAL ? f : config->forgetting; /* before f may change */
    if (config->separate != 0U && state->started != 0U && state->frozen == 0U) {
        forget_separately(config, state, p);
        f = PMF_R(1.0);
    }
    if (config->scheme == PMF_DIRECTIONAL) {
        fade = PMF_R(1.0);
        if (state->started != 0U) {
            forget_direction(config, state, column, p);
        }
    }
    add_sample(&state->sums, f, column, p, instrumental,
               state->started <= config->residual_updates ? 1U : 0U); /* later nobody reads it */
#if PMF_WINDOW_BLOCKS > 0
    if (config->scheme == PMF_WINDOW) {
        slide_window(config, state, column);
    }
#endif
    state->mass = fade * state->mass + (PMF_R(1.0) - fade);
    state->updates += state->updates < SATURATED ? 1U : 0U;
}

/* Constant trace (Goodwin and Sin 1984, section 3.3) keeps that of P at the end of the first memory, each parameter in
 * its own units. */
static void note_trace(const pmf_recursion_config_t *config, pmf_recursion_state_t *state, uint32_t status)
{
    real_t sum = PMF_R(0.0), memories = (real_t)state->updates * (PMF_R(1.0) - config->forgetting);
    uint32_t i;
    if (!(state->trace > PMF_R(0.0)) && (memories < PMF_R(1.0) || status != 0U)) {
        return;
    }
    for (i = 0; i < config->n_parameters; ++i) {
        if (!(state->trace > PMF_R(0.0))) {
            state->reference[i] = state->estimate.variance_factor[i];
        }
        sum += state->estimate.variance_factor[i] / (state->reference[i] + TINY);
    }
    state->trace = sum / (real_t)config->n_parameters;
}

/* Is the innovation larger than the known noise makes it? */
static uint32_t check_model(const pmf_recursion_config_t *config, pmf_recursion_state_t *state, real_t target)
{
    const real_t *theta = state->estimate.theta, memory = config->check_memory;
    real_t explained = config->target_power;
    uint32_t i, j;
    state->check_weight = memory * state->check_weight + PMF_R(1.0);
    state->check_innovation =
        memory * state->check_innovation + state->estimate.innovation * state->estimate.innovation;
    state->check_target = memory * state->check_target + target * target;
    for (i = 0; i < config->n_parameters; ++i) {
        explained -= PMF_R(2.0) * theta[i] * config->target_noise[i];
        for (j = 0; j < config->n_parameters; ++j) {
            explained += theta[i] * config->noise[i][j] * theta[j];
        }
    }
    explained = explained * state->check_weight + NEGLIGIBLE * state->check_target;
    if (PMF_R(2.0) * (PMF_R(1.0) - memory) * state->check_weight < PMF_R(1.0)) {
        return 0U; /* less than half the memory is filled */
    }
    return state->check_innovation > config->unexplained * explained ? (uint32_t)PMF_UNMODELLED : 0U;
}

/* Row i of half = L^-1 W, with the rows above it. */
PMF_INLINE void forward_row(uint32_t p, uint32_t i, real_t cross[N][N], real_t lower[N][N], real_t half[N][N])
{
    uint32_t j, k;
    for (j = 0; j < p; ++j) {
        real_t sum = cross[i][j];
        for (k = 0; k < i; ++k) {
            sum -= lower[i][k] * half[k][j];
        }
        half[i][j] = sum;
    }
}

/* information = W^T Z^-1 W (lower half), move = W^T Z^-1 move; smallest relative pivot of Z before the first estimate. */
PMF_INLINE real_t project(pmf_recursion_state_t *state, uint32_t p, real_t information[N][N], real_t move[N])
{
    real_t lower[N][N], inverse[N], half[N][N], projected[N];
    uint32_t i, j, k;
    factorise(p, state->sums.square, lower, inverse);
    forward(p, lower, move);
    for (i = 0; i < p; ++i) {
        projected[i] = PMF_R(0.0);
        for (j = 0; j <= i; ++j) {
            information[i][j] = PMF_R(0.0);
        }
    }
    for (k = 0; k < p; ++k) {
        real_t scaled = move[k] * inverse[k];
        forward_row(p, k, state->sums.cross, lower, half);
        for (i = 0; i < p; ++i) {
            real_t weighted = half[k][i] * inverse[k];
            projected[i] += half[k][i] * scaled;
            for (j = 0; j <= i; ++j) {
                information[i][j] += weighted * half[k][j];
            }
        }
    }
    for (i = 0; i < p; ++i) {
        move[i] = projected[i];
    }
    return state->started == 0U ? smallest_pivot(p, state->sums.square, inverse) : PMF_R(1.0);
}

/* Information less what the known noise feigns. Where hardly anything is left, that is poor excitation: some is kept,
 * so that P stays positive. */
PMF_INLINE uint32_t subtract_noise(const pmf_recursion_config_t *config, const pmf_recursion_state_t *state, uint32_t p,
                                   real_t information[N][N])
{
    uint32_t i, j, poor = 0U;
    for (i = 0; i < p; ++i) {
        real_t least = LEAST_CLEAN * information[i][i];
        for (j = 0; j <= i; ++j) {
            information[i][j] -= state->sums.weight * config->noise[i][j];
        }
        if (information[i][i] < least) {
            information[i][i] = least;
            poor = PMF_POOR_EXCITATION;
        }
    }
    return poor;
}

/* Adds the regularisation and says whether there is information left to forget. */
PMF_INLINE void regularise(const pmf_recursion_config_t *config, pmf_recursion_state_t *state, uint32_t p,
                              real_t information[N][N])
{
    real_t leak = PEAK_LEAK * (PMF_R(1.0) - config->forgetting);
    uint32_t i;
    state->frozen = 1U;
    for (i = 0; i < p; ++i) {
        real_t now = information[i][i], leaked = state->peak[i] - leak * now;
        state->peak[i] = now > leaked ? now : leaked;
        if (now > FREEZE * config->regularization * state->peak[i]) {
            state->frozen = 0U;
        }
        information[i][i] = now + state->mass * config->regularization * state->peak[i];
    }
}

/* Diagonal of P = (L D L^T)^-1, and whether a parameter's own information is little more than the regularisation. */
PMF_INLINE uint32_t judge(const pmf_recursion_config_t *config, pmf_recursion_state_t *state, uint32_t p)
{
    real_t threshold = POOR * state->mass * config->regularization;
    uint32_t i, j, k, poor = 0U;
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
        if (PMF_R(1.0) < sum * threshold * state->peak[i] || state->peak[i] <= TINY) {
            poor = 1U;
        }
    }
    return poor != 0U ? (uint32_t)PMF_POOR_EXCITATION : 0U;
}

PMF_INLINE void note_innovation(const pmf_recursion_config_t *config, pmf_recursion_state_t *state)
{
    real_t f = state->frozen != 0U ? PMF_R(1.0) : config->forgetting;
    if (state->started > SKIPPED_INNOVATIONS && state->frozen == 0U) {
        state->weight = f * state->weight + PMF_R(1.0);
        state->innovation_square = f * state->innovation_square + state->estimate.innovation * state->estimate.innovation;
        state->estimate.innovation_variance = state->innovation_square / state->weight;
    }
}

/* What theta shall be moved by, before the gain: from the right-hand side while the estimate is young (nothing
 * of the first solution's rounding stays), from the innovation afterwards (rounding of the sums does not enter). */
PMF_INLINE void residual(const pmf_recursion_config_t *config, const pmf_recursion_state_t *state,
                            const real_t *zeta, uint32_t p, uint32_t instrumental, real_t move[N])
{
    uint32_t i, j, young = state->started <= config->residual_updates ? 1U : 0U;
    for (i = 0; i < p; ++i) {
        if (young == 0U) {
            move[i] = zeta[i] * state->estimate.innovation;
        } else {
            move[i] = state->sums.right[i];
            for (j = 0; j < p; ++j) {
                move[i] -= (instrumental == 0U && j > i ? state->sums.cross[j][i] : state->sums.cross[i][j]) * state->estimate.theta[j];
            }
        }
        if (config->compensated != 0U) {
            real_t weight = young != 0U ? state->sums.weight : PMF_R(1.0);
            move[i] -= weight * config->target_noise[i];
            for (j = 0; j < p; ++j) {
                move[i] += weight * config->noise[i][j] * state->estimate.theta[j];
            }
        }
    }
}

/* Spread of theta by blocks of innovations against that of white ones: an estimate by batch means of how much longer
 * or shorter than sqrt(P) times the innovations' size the error bars must be. `move` is a block's sum after the gain. */
static void note_block(const pmf_recursion_config_t *config, pmf_recursion_state_t *state, const real_t move[N])
{
    real_t share = state->sums.weight / (real_t)config->block, keep, white;
    uint32_t i;
    state->blocks += state->blocks < BLOCK_MEMORY ? 1U : 0U;
    keep = PMF_R(1.0) - PMF_R(1.0) / (real_t)state->blocks;
    for (i = 0; i < config->n_parameters; ++i) {
        white = state->estimate.variance_factor[i] * state->estimate.innovation_variance;
        state->spread[i] = keep * state->spread[i] +
                           (PMF_R(1.0) - keep) * (white > TINY ? move[i] * move[i] * share / white : PMF_R(1.0));
        if (state->blocks >= MIN_BLOCKS) {
            state->estimate.inflation[i] = state->spread[i];
        }
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

/* Gathers the innovations of a block; at its end its effect on theta is compared with that of white ones. */
static void note_score(const pmf_recursion_config_t *config, pmf_recursion_state_t *state, const real_t *zeta)
{
    uint32_t p = config->n_parameters, i, j;
    for (i = 0; i < p; ++i) {
        state->score[i] += zeta[i] * state->estimate.innovation - config->target_noise[i];
        for (j = 0; j < p && config->compensated != 0U; ++j) {
            state->score[i] += config->noise[i][j] * state->estimate.theta[j];
        }
    }
    state->block_updates += 1U;
    if (state->block_updates >= config->block) {
        real_t move[N], unused[N][N];
        for (i = 0; i < p; ++i) {
            move[i] = state->score[i];
            state->score[i] = PMF_R(0.0);
        }
        if (config->instrumental != 0U) {
            (void)project(state, p, unused, move);
        }
        solve(state, p, move);
        note_block(config, state, move);
        state->block_updates = 0U;
    }
}

PMF_INLINE uint32_t update(const pmf_recursion_config_t *config, pmf_recursion_state_t *state,
                              const real_t *column, uint32_t p, uint32_t instrumental)
{
    real_t information[N][N], move[N], pivot = PMF_R(1.0), own;
    uint32_t i, j, status, compensated = 0U, unmodelled = 0U;
    state->estimate.innovation = column[p];
    for (i = 0; i < p; ++i) {
        state->estimate.innovation -= column[i] * state->estimate.theta[i];
    }
    accumulate(config, state, column, p, instrumental);
    if (config->compensated != 0U && state->updates < config->min_updates) {
        state->estimate.innovation = PMF_R(0.0); /* less information than the noise feigns: nothing to factorise yet */
        return PMF_STARTING | PMF_POOR_EXCITATION;
    }
    residual(config, state, instrumental != 0U ? &column[p + 1U] : column, p, instrumental, move);
    if (instrumental != 0U) {
        pivot = project(state, p, information, move);
    } else {
        for (i = 0; i < p; ++i) {
            for (j = 0; j <= i; ++j) {
                information[i][j] = state->sums.cross[i][j];
            }
        }
        compensated = config->compensated != 0U ? subtract_noise(config, state, p, information) : 0U;
    }
    regularise(config, state, p, information);
    factorise(p, information, state->factor, state->inverse_pivot);
    status = judge(config, state, p) | compensated;
    if (state->started == 0U) {
        own = smallest_pivot(p, information, state->inverse_pivot);
        pivot = own < pivot ? own : pivot;
        if (state->updates < config->min_updates || !(pivot > config->pivot)) {
            state->estimate.innovation = PMF_R(0.0);
            return PMF_STARTING | PMF_POOR_EXCITATION;
        }
    }
    state->started += state->started < SATURATED ? 1U : 0U;
    if (status == 0U || state->started == 1U) { /* else the noise alone would carry theta away in a long while */
        solve(state, p, move);
        for (i = 0; i < p; ++i) {
            state->estimate.theta[i] += move[i];
        }
    }
    note_innovation(config, state);
    if (config->scheme == PMF_CONSTANT_TRACE) {
        note_trace(config, state, status);
    }
    if (config->unexplained > PMF_R(0.0) && state->started > SKIPPED_INNOVATIONS) {
        unmodelled = check_model(config, state, column[p]);
    }
    if (config->block > 0U && state->weight > PMF_R(0.0) && status == 0U) {
        note_score(config, state, instrumental != 0U ? &column[p + 1U] : column);
    }
    status |= unmodelled | (status != 0U && instrumental != 0U ? (uint32_t)PMF_COMPENSATION_HELD : 0U);
    return status;
}

/* The same code with the number of parameters as a constant: loops unroll, the bits stay. */
static uint32_t dispatch(const pmf_recursion_config_t *config, pmf_recursion_state_t *state, const real_t *column)
{
#if PMF_MAX_PARAMETERS >= 5
    switch (config->n_parameters * 2U + config->instrumental) {
    case 6: return update(config, state, column, 3U, 0U);
    case 7: return update(config, state, column, 3U, 1U);
    case 8: return update(config, state, column, 4U, 0U);
    case 9: return update(config, state, column, 4U, 1U);
    case 10: return update(config, state, column, 5U, 0U);
    default: break;
    }
#endif
#if PMF_MAX_PARAMETERS >= 8 && !defined(PMF_SMALL)
    switch (config->n_parameters * 2U + config->instrumental) {
    case 11: return update(config, state, column, 5U, 1U);
    case 12: return update(config, state, column, 6U, 0U);
    case 13: return update(config, state, column, 6U, 1U);
    case 14: return update(config, state, column, 7U, 0U);
    case 16: return update(config, state, column, 8U, 0U);
    default: break;
    }
#endif
    return update(config, state, column, config->n_parameters, config->instrumental);
}

static int finite_state(const pmf_recursion_state_t *state, uint32_t p)
{
    real_t sum = state->innovation_square;
    uint32_t i;
    for (i = 0; i < p; ++i) {
        sum += state->estimate.theta[i] + state->estimate.variance_factor[i];
    }
    return sum - sum == PMF_R(0.0);
}

/* Forget everything but the last finite estimate. */
static void restart(pmf_recursion_state_t *state, const real_t theta[N], uint32_t p)
{
    uint32_t i;
    pmf_clear(state, (uint32_t)sizeof *state);
    for (i = 0; i < p; ++i) {
        state->estimate.theta[i] = theta[i];
    }
}

uint32_t pmf_recursion_step(const pmf_recursion_config_t *config, pmf_recursion_state_t *state,
                            const real_t *column)
{
    uint32_t p = config->n_parameters, i, status;
    real_t theta[N];
    for (i = 0; i < p; ++i) {
        theta[i] = state->estimate.theta[i];
    }
    status = dispatch(config, state, &column[config->first_column]);
    if (!finite_state(state, p)) {
        restart(state, theta, p);
        status = PMF_RESET | PMF_STARTING;
    }
    return status;
}

static void discount_sums(pmf_sums_t *sums, uint32_t p, real_t factor)
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
}

void pmf_recursion_discount(const pmf_recursion_config_t *config, pmf_recursion_state_t *state, real_t factor)
{
#if PMF_WINDOW_BLOCKS > 0
    uint32_t block;
    for (block = 0; config->scheme == PMF_WINDOW && block < PMF_WINDOW_BLOCKS; ++block) {
        discount_sums(&state->window[block], config->n_parameters, factor);
    }
#endif
    discount_sums(&state->sums, config->n_parameters, factor);
}

void pmf_recursion_covariance(const pmf_recursion_config_t *config, const pmf_recursion_state_t *recursion, real_t *p)
{
    uint32_t n = config->n_parameters, i, j, k, column;
    for (column = 0; column < n; ++column) {
        real_t x[N];
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
        for (i = 0; i < n; ++i) { /* symmetric to the last bit: the lower half is copied */
            p[i * n + column] = i >= column ? x[i] : p[column * n + i];
        }
    }
}
