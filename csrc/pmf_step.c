/* The step of one sample through encoder, network and recursion. SPDX-License-Identifier: Apache-2.0 */
#include "pmf_bytes.h"

#include "pmf_late.inl"

/* Status bits of the instrumental recursion that remain with the estimate of the simpler method. */
#define KEPT_ON_FALLBACK ((uint32_t)(PMF_RESET | PMF_UNMODELLED | PMF_FEEDBACK))

PMF_API void pmf_init(const pmf_config_t *config, pmf_state_t *state)
{
    pmf_clear(state, (uint32_t)sizeof *state);
    state->settle = PMF_W(config->first_samples);
    state->encoder.idle = PMF_W(config->encoder.standstill_samples); /* at rest until a count shows a motion */
#if PMF_WITH_AUXILIARY
    pmf_auxiliary_start(&config->auxiliary, &state->auxiliary);
#endif
#if PMF_STEPS
    state->encoder.ratio = PMF_R(1.0);
    state->encoder.ratio_before = PMF_R(1.0);
#endif
}

#if PMF_STEPS
void pmf_set_step(const pmf_config_t *config, pmf_state_t *state, real_t step)
{
    real_t ratio = step * config->encoder.rate;
    state->encoder.ratio = ratio > PMF_LEAST_RATIO && ratio < PMF_MOST_RATIO ? ratio : PMF_R(0.0);
}
#endif

#if PMF_WHOLE
void pmf_rebase(pmf_state_t *state, uint32_t count)
{
#if PMF_WITH_GUARD
    if (state->guard.readings > 0U) {
        state->guard.zero = count - state->guard.count[PMF_PAST + state->guard.readings - 1U];
        return;
    }
#endif
    state->encoder.count = count;
}
#endif

PMF_API uint32_t pmf_parameters(const pmf_config_t *config)
{
#if PMF_WITH_AUXILIARY
    if (PMF_MODELLED(config)) {
        return config->instrument.n_parameters;
    }
#endif
    return config->direct.n_parameters;
}

/* Clear the filters, which may hold infinite values. */
static void restart_filters(const pmf_config_t *config, pmf_state_t *state)
{
    pmf_clear(&state->network, (uint32_t)sizeof state->network);
    state->settle = PMF_W(config->settle_samples);
#if PMF_WITH_AUXILIARY
    pmf_auxiliary_start(&config->auxiliary, &state->auxiliary);
    state->auxiliary.velocity = PMF_R(0.0);
    state->auxiliary.position = PMF_R(0.0);
#endif
}

#if PMF_WITH_AUXILIARY
/* The nodes that the auxiliary model writes. */
typedef struct {
    real_t signal[PMF_SIGNALS];
} signals_t;

/* Step the auxiliary model if it has parameters. Lanes without them keep only the model and its signals: a copy of the
 * whole state takes as long as several samples. */
static void step_model(const pmf_config_t *config, pmf_state_t *state)
{
    truth_t running = state->auxiliary.running != 0U;
    signals_t *signals = (signals_t *)(void *)state->network.node;
    PMF_WHERE(running, &state->auxiliary,
              PMF_WHERE(running, signals, pmf_auxiliary_step(&config->auxiliary, &state->auxiliary, signals->signal)));
}
#endif

/* Run encoder, auxiliary model and network on a sample that the guard has passed. */
#if PMF_STEPS && PMF_LAYOUT != 0U && defined(__GNUC__) /* the step is the only caller in an export */
__attribute__((always_inline)) inline
#endif
    static whole_t filter_sample(const pmf_config_t *config, pmf_state_t *state, real_t input, whole_t count)
{
    whole_t status = pmf_encoder_step(&config->encoder, &state->encoder, input, count, state->network.node);
    truth_t settling;
    if (PMF_ANY(state->hold > 0U)) {
        state->hold -= PMF_BIT(state->hold > 0U, 1U);
    }
#if PMF_LATE
    if (config->late.kept != 0U) {
        delay_input(&config->late, state);
    }
#endif
#if PMF_WITH_AUXILIARY
#if PMF_SHAPED
    pmf_shapes_measured(&config->auxiliary.shapes, state->network.node);
#endif
    if (PMF_MODELLED(config)) {
#if PMF_STEPS
        if (config->auxiliary.steps != 0U) {
            state->auxiliary.step = config->auxiliary.dt * state->encoder.ratio_before;
        }
#endif
#if PMF_LATE
        if (config->late.kept != 0U && state->auxiliary.running != 0U) {
            pmf_auxiliary_late_step(&config->auxiliary, &state->auxiliary, &state->late, state->network.node);
        } else
#endif
            step_model(config, state);
    }
#endif
#if PMF_STEPS
    if (PMF_STEPPED(config->encoder.rate > PMF_R(0.0))) {
        state->network.ratio = state->encoder.ratio;
        state->network.ratio_before = state->encoder.ratio_before;
        state->encoder.ratio_before = state->encoder.ratio;
        state->encoder.ratio = PMF_R(1.0);
    }
#endif
    pmf_network_step(&config->network, &state->network);
#if PMF_WITH_AUXILIARY
    if (PMF_MODELLED(config)) {
        pmf_auxiliary_correct(&config->auxiliary, &state->auxiliary, config->instrument.first_column,
                              state->network.column);
    }
#endif
    state->settle = PMF_IF((status & PMF_SETTLING) != 0U, PMF_W(config->settle_samples), state->settle);
    settling = state->settle > 0U;
    if (PMF_ANY(settling)) {
#if PMF_WITH_AUXILIARY
        if (PMF_MODELLED(config)) {
            /* the model takes the known velocity at once, instead of approaching it with its own time constant */
            truth_t half_way = settling & (state->settle == config->settle_samples / 2U);
            state->auxiliary.velocity =
                PMF_IF(half_way, state->network.column[config->auxiliary.check_column], state->auxiliary.velocity);
            state->auxiliary.position =
                PMF_IF(half_way, state->network.node[PMF_LATE_POSITION], state->auxiliary.position);
        }
#endif
        state->settle -= PMF_BIT(settling, 1U);
        status |= PMF_BIT(settling, PMF_SETTLING);
    }
    status |= PMF_BIT(state->hold > 0U, PMF_SETTLING);
    return status;
}

#if PMF_WITH_AUXILIARY
/* Write the direct estimate in the parameters of the instrumental estimate. */
static void borrow_estimate(const pmf_config_t *config, const pmf_estimate_t *direct, pmf_state_t *state)
{
    const pmf_auxiliary_config_t *auxiliary = &config->auxiliary;
    pmf_estimate_t *borrowed = &state->borrowed;
    uint32_t i;
    for (i = 0; i < PMF_ROLES; ++i) {
        if (auxiliary->index[i] != PMF_NO_PARAMETER && auxiliary->direct_index[i] != PMF_NO_PARAMETER) {
            borrowed->theta[auxiliary->index[i]] = direct->theta[auxiliary->direct_index[i]];
            borrowed->variance_factor[auxiliary->index[i]] = direct->variance_factor[auxiliary->direct_index[i]];
            borrowed->inflation[auxiliary->index[i]] = direct->inflation[auxiliary->direct_index[i]];
        }
    }
#if PMF_SHAPED
    for (i = 0; i < auxiliary->shapes.n; ++i) { /* the direct estimate has only some parameters */
        uint32_t own = auxiliary->index[PMF_BODY_ROLES + i];
        if (own != PMF_NO_PARAMETER && auxiliary->direct_index[PMF_BODY_ROLES + i] == PMF_NO_PARAMETER) {
            borrowed->variance_factor[own] = PMF_UNKNOWN;
        }
    }
#endif
    borrowed->innovation = direct->innovation;
    borrowed->innovation_variance = direct->innovation_variance;
}

#if PMF_STEPS
/* A sum over samples becomes an integral over time. Each row, one sample late, has half the weight of its two
 * neighbouring steps. Otherwise the samples of a burst would have all weight, and the pause none. */
static void weigh_instruments(const pmf_recursion_config_t *config, pmf_network_state_t *network)
{
    real_t longest = (real_t)PMF_LONGEST, *zeta = &network->column[config->first_column + config->n_parameters + 1U];
    real_t weight = PMF_R(0.5) * ((network->ratio < longest ? network->ratio : longest) +
                                  (network->ratio_before < longest ? network->ratio_before : longest));
    uint32_t i;
    for (i = 0; i < config->n_parameters; ++i) {
        zeta[i] *= weight;
    }
}
#endif

/* The instrumental estimate takes over after a fair fraction of the direct estimate's samples. The instrumental
 * estimate must also know the mass about as well as the direct estimate, or well enough. */
static truth_t takes_over(const pmf_config_t *config, const pmf_state_t *state)
{
    static const scalar_t TAKE_OVER = PMF_SCALAR(3.0); /* ratio of samples, or of variances */
    static const scalar_t SHORT_BAR = PMF_SCALAR(0.01); /* fraction of the mass as a small standard error */
    const pmf_estimate_t *own = &state->instrument.estimate, *direct = &state->direct.estimate;
    uint32_t mass = config->auxiliary.index[PMF_MASS], direct_mass = config->auxiliary.direct_index[PMF_MASS];
    real_t small = SHORT_BAR * own->theta[mass];
    /* samples weighted by a power of their number count less */
    real_t power = PMF_ALIKE((scalar_t)config->instrument.growing);
    real_t gathered = PMF_R(0.5) * (PMF_R(1.0) + power) * state->instrument.sums.weight;
    truth_t enough = TAKE_OVER * gathered > state->direct.sums.weight;
    enough = enough & ((own->variance_factor[mass] < TAKE_OVER * direct->variance_factor[direct_mass]) |
                       (own->variance_factor[mass] * own->inflation[mass] * own->innovation_variance < small * small));
    return (state->instrument.started > 0U) & ((state->direct.started == 0U) | enough);
}

/* Forget the early residuals of the instrumental estimate, which are not noise. Without forgetting these residuals
 * would stay in the error bars. They may be orders of magnitude larger than the direct residuals. */
static void forget_start(pmf_state_t *state, truth_t where)
{
    real_t limit = state->instrument.weight * state->direct.estimate.innovation_variance;
    where = where & (limit > PMF_R(0.0)) & (state->instrument.innovation_square > limit);
    state->instrument.innovation_square = PMF_IF(where, limit, state->instrument.innovation_square);
}

/* Use instrumental variables if the auxiliary model follows the plant, otherwise the direct estimate. */
static whole_t instrument_step(const pmf_config_t *config, pmf_state_t *state, whole_t direct_status, truth_t settled)
{
    const pmf_auxiliary_config_t *auxiliary = &config->auxiliary;
    truth_t held = state->hold != 0U; /* the measured velocity does not show the axis */
    truth_t trusted = pmf_auxiliary_check(auxiliary, &state->auxiliary, state->network.column, held), in_charge,
            borrows;
    const pmf_estimate_t *own = &state->instrument.estimate, *direct = &state->direct.estimate;
    whole_t status, stepped = PMF_W(0);
    /* sums with a wrong direction would stay */
    PMF_WHERE(PMF_NOT(trusted) & (state->instrument.updates != 0U), &state->instrument,
              pmf_clear(&state->instrument, (uint32_t)sizeof state->instrument));
    status = PMF_BIT(PMF_NOT(trusted) | (state->instrument.started == 0U), PMF_STARTING);
#if PMF_STEPS
    if (PMF_STEPPED(config->encoder.rate > PMF_R(0.0))) {
        weigh_instruments(&config->instrument, &state->network);
    }
#endif
    PMF_WHERE(trusted & settled, &state->instrument,
              stepped = pmf_recursion_step(&config->instrument, &state->instrument, state->network.column));
    status = PMF_IF(trusted & settled, stepped, status);
    status |= pmf_auxiliary_feedback(&state->auxiliary, state->network.node, trusted & settled,
                                     state->encoder.input - state->encoder.input_before);
    status |= pmf_auxiliary_late(auxiliary, &state->auxiliary, state->network.column,
                                 trusted & settled & (state->auxiliary.in_charge != 0U));
    in_charge = trusted & (state->auxiliary.in_charge != 0U);
    if (PMF_ANY(trusted & PMF_NOT(in_charge))) {
        in_charge = in_charge | (trusted & takes_over(config, state));
        forget_start(state, in_charge & (state->auxiliary.in_charge == 0U));
    }
    state->auxiliary.in_charge = PMF_BIT(in_charge, 1U);
    pmf_auxiliary_follow(auxiliary, &state->auxiliary, in_charge, own->theta, auxiliary->index);
    if (PMF_ALL(in_charge)) {
        return status;
    }
    borrows = PMF_NOT(in_charge) & (state->direct.started != 0U) & ((direct_status & PMF_POOR_EXCITATION) == 0U);
    if (auxiliary->has_initial != 0U) {
        borrows = borrows & PMF_NOT(trusted);
    }
    pmf_auxiliary_follow(auxiliary, &state->auxiliary, borrows, direct->theta, auxiliary->direct_index);
    PMF_WHERE(PMF_NOT(in_charge), &state->borrowed, borrow_estimate(config, direct, state));
    direct_status = (direct_status & ~(uint32_t)PMF_COMPENSATION_HELD) | PMF_FALLBACK;
    return PMF_IF(in_charge, status, direct_status | (status & KEPT_ON_FALLBACK));
}

#endif

#if PMF_PROCESS
PMF_API void pmf_lift(const pmf_config_t *config, pmf_state_t *state)
{
    pmf_recursion_lift(&config->direct, &state->direct, &state->lifted);
}
#endif

#if PMF_WHOLE /* for one axis */
const pmf_estimate_t *pmf_estimate(const pmf_config_t *config, const pmf_state_t *state)
{
#if PMF_PROCESS
    if (config->direct.constant != PMF_NO_PARAMETER) {
        return &state->lifted;
    }
#endif
#if PMF_WITH_AUXILIARY
    if (PMF_MODELLED(config)) {
        return (state->status & PMF_FALLBACK) == 0U ? &state->instrument.estimate : &state->borrowed;
    }
#endif
    (void)config;
    return &state->direct.estimate;
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
#endif

/* Run the recursions on the columns of this sample, unless the filters settle. */
static whole_t estimate_step(const pmf_config_t *config, pmf_state_t *state, whole_t filtered)
{
    whole_t status = PMF_BIT(state->direct.started == 0U, PMF_STARTING), stepped = PMF_W(0);
    truth_t settled = (filtered & PMF_SETTLING) == 0U, use = settled;
#if PMF_WITH_AUXILIARY
    if (PMF_MODELLED(config)) { /* the second half of the settling belongs to the model */
        use = use | ((state->hold == 0U) & (state->settle < config->settle_samples / 2U));
    }
#endif
    PMF_WHERE(use, &state->direct,
              stepped = pmf_recursion_step(&config->direct, &state->direct, state->network.column));
    status = PMF_IF(use, stepped, status);
#if PMF_STEPS
    /* a larger mean square of the step over time [squared periods] makes direct methods err by percents */
    if (PMF_TURNED(&config->encoder) != 0U && state->network.cubes > PMF_R(2.0) * state->network.time) {
        status |= PMF_UNMODELLED;
    }
#endif
#if PMF_WITH_AUXILIARY
    if (PMF_MODELLED(config)) {
        status = instrument_step(config, state, status, settled);
    }
#endif
    return status;
}

static whole_t step_sample(const pmf_config_t *config, pmf_state_t *state, real_t input, whole_t count, whole_t guarded)
{
    whole_t status = filter_sample(config, state, input, count) | guarded;
#if PMF_PROCESS
    state->direct.lift = config->direct.lift * PMF_TO_REAL(state->encoder.first);
#endif
    status |= estimate_step(config, state, status);
    PMF_WHERE((status & PMF_RESET) != 0U, state, restart_filters(config, state));
    state->status = status;
#if PMF_PROCESS
    if (config->direct.constant != PMF_NO_PARAMETER) {
        pmf_lift(config, state);
    }
#endif
    return status;
}

#if PMF_WITH_GUARD
/* Return the status while the guard waits for its first counts. The estimate stays. */
static whole_t waiting(const pmf_state_t *state)
{
    return (state->status & (uint32_t)PMF_FALLBACK) | PMF_SETTLING | PMF_BIT(state->direct.started == 0U, PMF_STARTING);
}

/* Replace a sample by the one that the guard has judged, and return whether there is one. The recursion waits until the
 * filters have forgotten a count that may be wrong. */
static truth_t guard_sample(const pmf_config_t *config, pmf_state_t *state, real_t *input, whole_t *count,
                            whole_t *guarded)
{
    truth_t ready = pmf_guard(&config->encoder, &state->guard, state->encoder.input, input, count, guarded), unsure;
    unsure = (*guarded & PMF_SETTLING) != 0U;
    if (PMF_ANY(unsure)) {
        state->hold = PMF_IF(unsure, PMF_W(config->settle_samples), state->hold);
    }
    return ready;
}
#endif

PMF_API whole_t pmf_filter(const pmf_config_t *config, pmf_state_t *state, real_t input, whole_t count)
{
    whole_t guarded = PMF_W(0), status = PMF_W(0);
#if PMF_WITH_GUARD
    if (config->encoder.guard != 0U) {
        truth_t ready = guard_sample(config, state, &input, &count, &guarded);
        PMF_WHERE(ready, state, status = filter_sample(config, state, input, count));
        return PMF_IF(ready, status | guarded, waiting(state));
    }
#endif
    status = filter_sample(config, state, input, count);
    return status | guarded;
}

PMF_API whole_t pmf_step(const pmf_config_t *config, pmf_state_t *state, real_t input, whole_t count)
{
    whole_t guarded = PMF_W(0);
#if PMF_WITH_GUARD
    if (config->encoder.guard != 0U) {
        truth_t ready = guard_sample(config, state, &input, &count, &guarded);
        state->status = PMF_IF(ready, state->status, waiting(state));
        PMF_WHERE(ready, state, (void)step_sample(config, state, input, count, guarded));
        return state->status;
    }
#endif
    return step_sample(config, state, input, count, guarded);
}

#if PMF_WHOLE
#if PMF_PROCESS
/* Compute the constant's row and column for the output itself. */
static void lift_covariance(const pmf_config_t *config, const pmf_state_t *state, real_t *p)
{
    uint32_t n = config->direct.n_parameters, constant = config->direct.constant, i;
    const real_t *lowest = &p[config->direct.lowest * n];
    for (i = 0; i < n; ++i) {
        if (i != constant) {
            p[constant * n + i] += state->direct.lift * lowest[i];
            p[i * n + constant] = p[constant * n + i];
        }
    }
    p[constant * n + constant] = state->lifted.variance_factor[constant];
}
#endif

void pmf_covariance_factor(const pmf_config_t *config, const pmf_state_t *state, real_t *p)
{
#if PMF_WITH_AUXILIARY
    if (PMF_MODELLED(config) && (state->status & PMF_FALLBACK) == 0U) {
        pmf_recursion_covariance(&config->instrument, &state->instrument, p);
        return;
    }
    if (PMF_MODELLED(config)) {
        uint32_t n = pmf_parameters(config), i;
        for (i = 0; i < n * n; ++i) {
            p[i] = i % (n + 1U) == 0U ? state->borrowed.variance_factor[i / (n + 1U)] : PMF_R(0.0);
        }
        return;
    }
#endif
    pmf_recursion_covariance(&config->direct, &state->direct, p);
#if PMF_PROCESS
    if (config->direct.constant != PMF_NO_PARAMETER) {
        lift_covariance(config, state, p);
    }
#endif
}
#endif
